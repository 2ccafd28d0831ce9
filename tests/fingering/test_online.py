"""Fingers that are found as notes come in sight."""

from dataclasses import replace

import pytest

from cadenza.fingering import online as module
from cadenza.fingering.online import OnlineFingering
from cadenza.fingers import Finger
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from players import find_fingering, shadow_hands
from watched import watched


def show(sight: OnlineFingering, *notes: Note) -> list[int]:
    """Show notes with their ends; return their numbers."""
    numbers = []
    for note in notes:
        numbers.append(sight.begin(note.pitch - PIANO.lowest_pitch, note.start))
        sight.end(numbers[-1], note.end)
    return numbers


@pytest.mark.parametrize("song", ["FurEliseOpening", "CanonInDOpening"])
def test_all_notes_at_once_get_what_the_search_finds(song):
    score = load_score(song).beginning(6.0)
    score = Score(tuple(replace(note, finger=None, velocity=80) for note in score.notes))
    sight = OnlineFingering(shadow_hands())
    numbers = show(sight, *score.notes)
    fingers = sight.find(0.0)
    expected, _ = find_fingering(score)
    assert [fingers[number] for number in numbers] == [n.finger for n in expected.notes]


def test_what_is_settled_stays_and_what_is_not_may_change():
    notes = [Note(0.2 * i, 0.2 * i + 0.2, pitch) for i, pitch in enumerate(range(60, 84))]
    sight, fingers = OnlineFingering(shadow_hands(["right"])), list[dict[int, Finger | None]]()
    for note in notes:
        show(sight, note)
        fingers.append(sight.find(note.start - 0.3))
    asked = [
        [i for i, some in enumerate(fingers) if number in some] for number in range(len(notes))
    ]
    assert all(rounds == list(range(rounds[0], rounds[-1] + 1)) for rounds in asked)
    assert max(map(len, asked)) == 3  # until it begins less than 0.3 s after what is settled
    assert any(fingers[rounds[0]][n] != fingers[rounds[-1]][n] for n, rounds in enumerate(asked))


@pytest.mark.parametrize("song", ["FurEliseOpening", "BachPreludeInCMajor"])
def test_goes_on_from_what_it_has_found_as_if_it_began_anew(song):
    notes, dt = load_score(song).beginning(4.0).notes, 0.05
    begins = [(round(note.start / dt), 1, i) for i, note in enumerate(notes)]
    ends = [(round(note.end / dt), 0, i) for i, note in enumerate(notes)]
    events = sorted(begins + ends)

    def happens(sight: OnlineFingering, step: int, begins: bool, note: int) -> None:
        if begins:
            sight.begin(notes[note].pitch - PIANO.lowest_pitch, step * dt)
        else:
            sight.end(note, (step - 0.5) * dt)

    sight = OnlineFingering(shadow_hands())
    for done, event in enumerate(events, start=1):
        happens(sight, *event)
        fingers = sight.find(0.0)
        if done % 10 == 0:
            anew = OnlineFingering(shadow_hands())
            for earlier in events[:done]:
                happens(anew, *earlier)
            assert fingers == anew.find(0.0)
    assert len(fingers) == len(notes) > 10


def test_held_note_keeps_its_finger_from_others_until_it_is_seen_to_end():
    sight = OnlineFingering(shadow_hands(["right"]))
    held = sight.begin(60 - PIANO.lowest_pitch, 0.0)
    fingers = [sight.find(0.1)[held]]
    for time in (1.0, 2.0):
        (number,) = show(sight, Note(time, time + 0.1, 62))
        fingers.append(sight.find(time + 0.1)[number])
    assert fingers[0] not in fingers[1:]
    sight.end(held, 2.5)
    numbers = show(sight, *(Note(3.0, 4.0, pitch) for pitch in (60, 62, 64, 65, 67)))
    assert len({sight.find(3.0)[number] for number in numbers}) == 5


def test_what_cannot_be_played_gets_no_finger():
    sight = OnlineFingering(shadow_hands(["right"]))
    numbers = show(sight, *(Note(0.0, 1.0, pitch) for pitch in (48, 60, 64, 67, 84)))
    fingers = list(sight.find(0.1).values())
    assert 0 < fingers.count(None) < len(numbers) == len(fingers)


def test_notes_that_are_settled_before_they_were_looked_at_get_fingers_later():
    notes = [Note(0.1 * i, 0.1 * i + 0.1, 60 + i % 5) for i in range(30)]
    sight = OnlineFingering(shadow_hands(["right"]), moments=12)
    numbers, fingers = show(sight, *notes), dict[int, Finger | None]()
    for _ in range(3):
        fingers |= sight.find(5.0)
    assert all(fingers[number] is not None for number in numbers)


def test_its_work_does_not_grow_with_the_song(monkeypatch):
    moments = watched(monkeypatch, module, "next_stage")
    sight, work = OnlineFingering(shadow_hands()), []
    for beat in range(160):
        time, pitch = beat / 4, (60, 64, 67, 72)[beat % 4]
        show(sight, Note(time, time + 0.25, pitch), Note(time, time + 0.5, pitch - 24))
        sight.find(time - 0.3)
        work.append(len(moments))
        moments.clear()
    assert max(work[:10]) == max(work) <= 3
