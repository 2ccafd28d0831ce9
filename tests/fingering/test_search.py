"""The fingers found for a score, against what hands can do and what pianists write."""

import itertools
from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.fingering.pianist import pianist_fingering
from cadenza.fingering.playable import playable
from cadenza.fingering.players import players_at
from cadenza.fingers import LEFT, RIGHT, SIDES, Side
from cadenza.hands.shadow import SHADOW
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score, songs
from cadenza.music.score import RELEASE_TIME, Note, Score, is_black
from melodies import melody
from music_strategies import lengths, monophonic_per_key, scores, times
from numbered import finger, numbers
from players import FOUR_FINGERS, find_fingering, shadow_hands, solve

REACH = SHADOW.reach
ORDER = shadow_hands().fingers  # from left to right


bare = Score.without_fingers


def chord(*pitches: int) -> Score:
    return Score(tuple(Note(0.0, 1.0, pitch) for pitch in pitches))


unfingered = scores().map(monophonic_per_key).map(bare)


# The keyboard


def test_keys_lie_where_the_model_has_them():
    np.testing.assert_array_equal([is_black(pitch) for pitch in PIANO.pitches], PIANO.is_black)
    np.testing.assert_allclose(PIANO.grid_y, PIANO.centre[:, 1], atol=6e-4)


# What hands can do


def check_hands(score: Score, sides: Collection[Side] = SIDES, as_written: bool = False) -> None:
    """Whenever a note begins, what is held lies in the order of the fingers, within their reach."""
    score = playable(bare(score), shadow_hands(sides), as_written).held(score)
    played = [note for note in score.notes if note.finger]
    for time in {note.start for note in played}:
        sounding = [n for n in played if n.start <= time and (n.end > time + RELEASE_TIME)]
        sounding += [n for n in played if n.start == time and n not in sounding]
        sounding.sort(key=lambda note: note.pitch)
        left_to_right = [ORDER.index(n.finger) for n in sounding]
        assert left_to_right == sorted(set(left_to_right)), (time, sounding)
        for a, b in itertools.combinations(sounding, 2):
            if a.finger.hand == b.finger.hand:
                first, second = sorted((a.finger.index, b.finger.index))
                distance = PIANO.grid_y[b.pitch - 21] - PIANO.grid_y[a.pitch - 21]
                assert REACH.least[first, second] <= distance <= REACH.most[first, second]


@settings(deadline=None)
@given(score=unfingered, sides=st.sampled_from([("right", "left"), ("right",), ("left",)]))
def test_any_score_can_be_played_or_says_why_not(score, sides):
    fingered, dropped = find_fingering(score, sides)
    check_hands(fingered, sides)
    assert bare(fingered) == score
    assert [d.note for d in dropped] == [note for note in fingered.notes if note.finger is None]
    assert all(d.reason for d in dropped)
    assert {n.finger.side for n in fingered.notes if n.finger} <= set(sides)
    assert fingered.has_fingering


@settings(deadline=None)
@given(score=unfingered)
def test_what_is_found_is_kept(score):
    """Given back, the fingers found contradict nothing and cost what they did."""
    first = solve(score)
    played = replace(first.score, notes=tuple(n for n in first.score.notes if n.finger))
    again = solve(played)
    assert again.score == played
    assert not again.ignored
    if not first.dropped:
        assert again.cost == pytest.approx(first.cost)


@settings(deadline=None)
@given(score=scores())
def test_given_fingers_are_kept_however_odd(score):
    fingered, dropped = find_fingering(score)
    for before, after in zip(score.notes, fingered.notes, strict=True):
        assert after.finger == before.finger or before.finger is None
    assert all(d.note in score.notes for d in dropped)


def test_a_score_with_all_fingers_comes_back():
    odd = Score(
        (
            Note(0, 1, 21, finger=finger(3)),
            Note(0, 1, 108, finger=finger(3)),
            Note(0, 1, 60, finger=finger(9)),
        )
    )
    assert find_fingering(odd) == (odd, ())


def test_a_note_held_keeps_its_finger_from_others():
    score = Score(
        (Note(0, 2, 60, finger=finger(0)), *(Note(t / 4, t / 4 + 0.25, 64) for t in range(8)))
    )
    fingered, dropped = find_fingering(score)
    assert not dropped
    assert 0 not in numbers(fingered)[2:]


def test_a_held_note_that_is_in_the_way_is_let_go_of():
    """The little finger has no finger beyond it, and the other hand cannot take the note over."""
    for little, beyond in ((4, 62), (9, 58)):
        score = Score((Note(0, 2, 60, finger=finger(little)), Note(1, 2, beyond)))
        assert not find_fingering(score)[1]
        assert playable(score, shadow_hands()).released == {0: 1}


def test_only_the_held_note_that_is_in_the_way_is_let_go_of():
    """Without the thumb, which was there first, the hand would still have no finger beyond."""
    held = (Note(0, 4, 60, finger=finger(0)), Note(1, 4, 67, finger=finger(4)))
    result = playable(Score((*held, Note(2, 4, 71))), shadow_hands(["right"]))
    assert (result.reasons, result.released) == ({}, {1: 2})


# What is dropped


def test_outer_notes_are_kept_when_there_are_too_many():
    score = chord(*range(21, 109))
    fingered, dropped = find_fingering(score)
    check_hands(fingered)
    assert [f for f in numbers(fingered) if f >= 0] == [9, 8, 7, 6, 5, 0, 1, 2, 3, 4]
    assert [numbers(fingered)[i] for i in (0, -1)] == [9, 4]
    assert len(dropped) == 78
    assert {reason for _, reason in dropped} == {"more than 10 notes at once for both hands"}


def test_what_no_hand_reaches_is_dropped_from_the_middle():
    _, dropped = find_fingering(chord(24, 60, 96))
    assert [(d.note.pitch, d.reason) for d in dropped] == [
        (60, "too far from the other notes for both hands")
    ]
    _, dropped = find_fingering(chord(48, 84), ["right"])
    assert [(d.note.pitch, d.reason) for d in dropped] == [
        (48, "too far from the other notes for the right hand")
    ]


def test_louder_notes_come_first():
    """Of two equally far inside a chord of six."""
    for loud in (64, 65):
        notes = (Note(0, 1, p, 100 if p == loud else 60) for p in (60, 62, 64, 65, 67, 69))
        _, dropped = find_fingering(Score(tuple(notes)), ["right"])
        assert [(d.note.pitch, d.reason) for d in dropped] == [
            (64 + 65 - loud, "more than 5 notes at once for the right hand")
        ]


def test_a_note_that_is_struck_twice_at_once_has_one_finger():
    fingered, dropped = find_fingering(Score((Note(0, 1, 60), Note(0, 0.5, 60), Note(0.01, 2, 60))))
    assert not dropped
    assert len(set(numbers(fingered))) == 1


@pytest.mark.parametrize("pitches", [(21, 22, 23), (106, 107, 108), (21, 108)])
def test_both_ends_of_the_keyboard(pitches):
    for sides in (("right", "left"), ("right",), ("left",)):
        for score in (melody(*pitches), melody(*pitches, length=0.05)):
            _, dropped = find_fingering(score, sides)
            assert not dropped


# Which hand plays what, as written


def written_for(score: Score, hands: Iterable[int]) -> Score:
    notes = zip(score.notes, itertools.cycle(hands), strict=False)
    return Score(tuple(replace(note, hands=(hand,)) for note, hand in notes))


def test_each_hand_plays_what_is_written_for_it():
    low = written_for(melody(40, 43, 47), [RIGHT])
    assert [n.finger.hand for n in find_fingering(low)[0].notes] == [LEFT] * 3
    assert [n.finger.hand for n in find_fingering(low, as_written=True)[0].notes] == [RIGHT] * 3


def test_a_note_that_is_written_for_both_hands_goes_to_either():
    score = Score(tuple(replace(n, hands=(RIGHT, LEFT)) for n in melody(40, 88).notes))
    assert [n.finger.hand for n in find_fingering(score, as_written=True)[0].notes] == [LEFT, RIGHT]


@settings(deadline=None)
@given(unfingered, st.lists(st.sampled_from([RIGHT, LEFT]), min_size=1))
def test_hands_as_written_are_within_what_hands_can_do(score, hands):
    fingered, dropped = find_fingering(written_for(score, hands), as_written=True)
    check_hands(fingered, as_written=True)
    assert [d.note for d in dropped] == [note for note in fingered.notes if note.finger is None]


def test_what_the_written_hand_cannot_play_goes_to_the_other():
    too_wide = written_for(chord(40, 62, 67), [RIGHT])
    fingered, dropped = find_fingering(too_wide, as_written=True)
    assert [n.finger.hand for n in fingered.notes] == [LEFT, RIGHT, RIGHT]
    assert not dropped


def test_where_written_hands_cross_the_notes_are_shared():
    together = written_for(chord(40, 60, 64), [RIGHT, LEFT, LEFT])
    assert not find_fingering(together, as_written=True)[1]
    held = [Note(0, 4, pitch, hands=(RIGHT,)) for pitch in (60, 64, 67)]
    over = Score((*held, Note(1, 2, 84, hands=(LEFT,))))
    assert not find_fingering(over, as_written=True)[1]


# What pianists play


def test_five_keys_in_a_row_take_the_five_numbers():
    fingered, _ = find_fingering(melody(72, 74, 76, 77, 79, 77, 76, 74, 72), ["right"])
    assert numbers(fingered) == [0, 1, 2, 3, 4, 3, 2, 1, 0]
    fingered, _ = find_fingering(melody(48, 50, 52, 53, 55, 53, 52, 50, 48), ["left"])
    assert numbers(fingered) == [9, 8, 7, 6, 5, 6, 7, 8, 9]


def test_triads_and_octaves():
    assert numbers(find_fingering(chord(72, 76, 79), ["right"])[0]) == [0, 2, 4]
    assert numbers(find_fingering(chord(48, 60), ["left"])[0]) == [9, 5]


def test_a_repeated_key_keeps_its_finger():
    for seconds in (0.1, 0.5):
        fingered, _ = find_fingering(melody(*[67] * 6, 69, *[67] * 3, length=seconds))
        assert len({n.finger for n in fingered.notes if n.pitch == 67}) == 1


def test_low_notes_go_left_and_high_notes_right():
    fingered, _ = find_fingering(Score((*chord(36, 43).notes, *chord(84, 88).notes)))
    assert [note.finger.hand for note in fingered.notes] == [1, 1, 0, 0]


def test_agrees_with_the_bundled_fingering():
    """Written by a person's rules: most hands are the same, more than half of the fingers."""
    hands, fingers = [], []
    for piece in songs():
        written = load_score(piece.name)
        fingered, dropped = find_fingering(bare(written))
        assert not dropped, piece.name
        check_hands(fingered)
        pairs = np.array([numbers(written), numbers(fingered)])
        hands.append((pairs[0] // 5 == pairs[1] // 5).mean())
        fingers.append((pairs[0] == pairs[1]).mean())
    assert np.mean(hands) > 0.9
    assert np.mean(fingers) > 0.55


@pytest.mark.parametrize("piece", songs(), ids=lambda piece: piece.name)
def test_the_bundled_fingering_is_possible_and_costs_more(piece):
    """Hands of people and of robots are alike enough for that."""
    written = load_score(piece.name)
    theirs, ours = solve(written), solve(bare(written))
    assert theirs.ignored == ()
    assert ours.cost <= theirs.cost + 1e-6


# Fingers of a pianist


@pytest.mark.parametrize("seconds", [0.1, 0.5])
@pytest.mark.parametrize(
    ("pitches", "side", "fingers"),
    [
        ((60, 62, 64, 65, 67, 69, 71, 72), "right", [1, 2, 3, 1, 2, 3, 4, 5]),
        ((72, 71, 69, 67, 65, 64, 62, 60), "right", [5, 4, 3, 2, 1, 3, 2, 1]),
        ((48, 50, 52, 53, 55, 57, 59, 60), "left", [5, 4, 3, 2, 1, 3, 2, 1]),
    ],
)
def test_a_pianists_fingers_of_scales(pitches, side, fingers, seconds):
    fingered, _ = pianist_fingering(melody(*pitches, length=seconds), shadow_hands([side]))
    assert [note.finger.index + 1 for note in fingered.notes] == fingers
    assert {note.finger.side for note in fingered.notes} == {side}


@settings(deadline=None)
@given(score=unfingered, sides=st.sampled_from([("right", "left"), ("right",), ("left",)]))
def test_a_pianists_fingers_are_those_that_the_hands_can_play_with(score, sides):
    fingered, dropped = pianist_fingering(score, shadow_hands(sides))
    check_hands(fingered, sides)
    split, left_out = find_fingering(score, sides)
    assert dropped == left_out
    assert [n.finger and n.finger.hand for n in fingered.notes] == [
        n.finger and n.finger.hand for n in split.notes
    ]


def test_a_pianists_fingers_agree_more_with_the_bundled_fingering():
    agreed = []
    for piece in songs():
        written = load_score(piece.name)
        by_robot, _ = find_fingering(bare(written), as_written=True)
        by_pianist, _ = pianist_fingering(written, shadow_hands())
        pairs = np.array([numbers(each) for each in (written, by_robot, by_pianist)])
        agreed.append((pairs[0] == pairs[1:]).mean(axis=1))
    robot, pianist = np.mean(agreed, axis=0)
    assert pianist > robot > 0.6


def test_hands_of_four_fingers_are_fingered_as_a_pianist_would_without_the_little_one():
    hands = players_at(FOUR_FINGERS, PIANO, ["right"], 0.3, slides=True)
    fingered, _ = pianist_fingering(melody(60, 62, 64, 65, 67, 69), hands)
    assert [note.finger.index + 1 for note in fingered.notes] == [1, 2, 3, 1, 2, 3]


# The search


@pytest.mark.parametrize(
    "score",
    [
        melody(60, 67, 61, length=0.1),
        chord(60, 64, 67),
        Score((Note(0, 1, 60), Note(0.3, 0.5, 64), Note(0.6, 1.0, 59))),
        Score((Note(0, 0.2, 48), Note(0, 0.2, 54), Note(0.2, 0.3, 54))),
    ],
    ids=["melody", "chord", "held", "repeated"],
)
def test_nothing_is_cheaper(score):
    """Among all ways to put ten fingers on three notes."""
    costs = []
    for choice in itertools.product(range(10), repeat=3):
        notes = zip(score.notes, choice, strict=True)
        solution = solve(
            replace(score, notes=tuple(replace(n, finger=finger(f)) for n, f in notes))
        )
        if not solution.ignored:
            costs.append(solution.cost)
    assert len(costs) > 20
    assert solve(score).cost == pytest.approx(min(costs))


WHITE_PITCHES = [pitch for pitch in range(21, 109) if not is_black(pitch)]


@settings(deadline=None)
@given(played=st.lists(st.tuples(times, lengths, st.integers(12, 39)), min_size=1, max_size=10))
def test_mirrored_music_costs_the_same(played):
    """On white keys, which lie symmetrically about the keyboard's middle."""
    there, mirrored = (
        monophonic_per_key(Score(tuple(Note(t, t + d, pitches[w]) for t, d, w in played)))
        for pitches in (WHITE_PITCHES, WHITE_PITCHES[::-1])
    )
    a, b = solve(there), solve(mirrored)
    released = [playable(each, shadow_hands()).released for each in (there, mirrored)]
    if not any((a.dropped, b.dropped, *released)):  # of two alike, the higher is taken
        assert a.cost == pytest.approx(b.cost)


def test_a_long_song():
    fingered, dropped = find_fingering(
        melody(*(60 + (7 * i) % 12 for i in range(2000)), length=0.2)
    )
    assert not dropped
    check_hands(replace(fingered, notes=fingered.notes[-50:]))
