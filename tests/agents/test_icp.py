"""Fingers by iterative closest points."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from cadenza.agents.baselines.icp import ICP, nearest_fingers, with_nearest_fingers
from cadenza.agents.rollout import play_episode
from cadenza.fingers import SIDES
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import players_of
from cadenza.tasks.piano_task import PianoTask


@pytest.fixture(scope="module")
def players():
    return players_of(build_scene(SceneConfig(hand="arm-allegro")))


def chord(*pitches: int, start: float = 0.0, end: float = 0.4) -> list[Note]:
    return [Note(start, end, pitch) for pitch in pitches]


def test_a_chord_as_wide_as_the_hand_is_played_by_all_fingers(players):
    """In their order, from the thumb outwards, which is to the left for the left hand."""
    assert nearest_fingers(chord(72, 76, 79, 83), 0, players) == [0, 1, 2, 3]
    assert nearest_fingers(chord(48, 52, 55, 59), 1, players) == [3, 2, 1, 0]


def test_notes_a_moment_apart_are_a_chord_wherever_they_are(players):
    for start in np.arange(0.0, 0.03, 0.005):
        low, *others = chord(84, 88, 91, 95, start=start)  # to the right of where the hand is
        later = [Note(start + 0.002, 0.4, note.pitch) for note in others]
        assert nearest_fingers([low, *later], 0, players) == [0, 1, 2, 3]


@pytest.mark.parametrize("hand", range(len(SIDES)))
def test_one_finger_plays_one_key_of_a_chord(players, hand):
    rng = np.random.default_rng(0)
    for _ in range(50):
        pitches = 60 + rng.choice(24, rng.integers(1, 5), replace=False)
        fingers = [
            f for f in nearest_fingers(chord(*pitches.tolist()), hand, players) if f is not None
        ]
        assert fingers
        assert len(set(fingers)) == len(fingers)


def test_more_notes_than_fingers(players):
    fingers = nearest_fingers(chord(72, 74, 76, 77, 79), 0, players)
    assert fingers.count(None) == 1


def test_nothing_moves_for_what_is_repeated(players):
    notes = [note for i in range(4) for note in chord(74, start=0.5 * i, end=0.5 * i + 0.45)]
    assert len(set(nearest_fingers(notes, 0, players))) == 1


def test_a_finger_that_holds_a_key_plays_no_other(players):
    held = chord(72, end=2.0)
    others = [note for i in range(1, 4) for note in chord(76, start=0.5 * i, end=0.5 * i + 0.4)]
    first, *rest = nearest_fingers([*held, *others], 0, players)
    assert first not in rest


def test_a_finger_has_to_leave_its_key_before_it_plays_another(players):
    """A melody without gaps has another finger on each new key."""
    scale: Sequence[int] = (72, 74, 76, 77, 79, 81, 83, 84)
    notes = [n for i, p in enumerate(scale) for n in chord(p, start=0.5 * i, end=0.5 * i + 0.5)]
    fingers = nearest_fingers(notes, 0, players)
    assert None not in fingers
    assert all(a != b for a, b in pairwise(fingers))


def test_a_melody_that_the_hand_covers_has_one_finger_for_each_key(players):
    """The hand is over the keys that come next, too, and its fingers do not cross."""
    melody = (77, 79, 75, 72, 75, 77, 79, 72, 77)
    notes = [n for i, p in enumerate(melody) for n in chord(p, start=0.25 * i, end=0.25 * i + 0.25)]
    fingers = nearest_fingers(notes, 0, players)
    assert fingers == [{72: 0, 75: 1, 77: 2, 79: 3}[pitch] for pitch in melody]


def test_a_finger_that_does_not_reach_from_a_held_key_is_not_the_nearest(players):
    notes = [*chord(62, end=0.4), *chord(69, end=1.49), *chord(60, start=0.75, end=0.99)]
    assert None not in nearest_fingers([*notes, *chord(59, start=1.0, end=1.24)], 0, players)


def test_a_finger_that_holds_a_key_longer_than_its_chord_is_not_free(players):
    short, long = Note(0.0, 0.2, 72), Note(0.0, 2.0, 76)
    notes = [short, long, *chord(75, start=0.5, end=0.9)]
    _, holds, other = nearest_fingers(notes, 0, players)
    assert other != holds


def test_a_finger_is_not_free_until_it_has_come_up(players):
    """0.05 s before its note ends it is, as it takes a tenth of a second to get to its next key."""
    first = chord(72, end=0.5)
    alone = nearest_fingers([*first, *chord(72, start=0.45, end=0.9)], 0, players)
    assert alone[0] == alone[1]
    free, still_down = (
        nearest_fingers([*first, *chord(74, start=start, end=0.9)], 0, players)
        for start in (0.75, 0.35)
    )
    assert still_down[1] not in (None, still_down[0])
    assert free[1] is not None


def test_a_key_struck_twice_at_once_or_again_has_one_finger(players):
    for other in (Note(0.0, 0.5, 72, 90), Note(0.0, 0.3, 72), Note(0.35, 0.9, 72)):
        finger, again = nearest_fingers([Note(0.0, 0.5, 72), other], 0, players)
        assert finger is not None
        assert again == finger


def test_notes_that_are_equal_are_all_kept():
    scene = build_scene(SceneConfig(hand="arm-allegro"))
    (track,) = PianoTask([Score((Note(0, 1, 60), Note(0, 1, 60)))], TaskConfig(), scene).tracks
    nearest = with_nearest_fingers(track.with_found_fingers())
    assert len(nearest.score.notes) == 2
    assert None not in [note.finger for note in nearest.score.notes]


def test_only_fingers_that_reach_a_key_are_given(players):
    rng = np.random.default_rng(0)
    for hand in (0, 1):
        reached = players.reaches(hand)
        keys = np.flatnonzero(reached.any(axis=1))
        ends = np.append(keys[:8], keys[-8:])
        pitches = rng.choice(ends, 40) + players.keyboard.lowest_pitch
        notes = [Note(0.5 * i, 0.5 * i + 0.4, int(pitch)) for i, pitch in enumerate(pitches)]
        fingers = nearest_fingers(notes, hand, players)
        assert None not in fingers
        assert all(reached[pitches - players.keyboard.lowest_pitch, fingers])


def test_hands_are_those_of_the_search_and_what_no_finger_plays_is_told(players):
    five = chord(72, 74, 76, 77, 79)  # for four fingers
    bass = chord(40, end=0.3)
    scene = build_scene(SceneConfig(hand="arm-allegro"))
    (track,) = PianoTask([Score((*five, *bass))], TaskConfig(), scene).tracks
    nearest = with_nearest_fingers(track.with_found_fingers())
    fingers = {note.pitch: note.finger for note in nearest.score.notes}
    searched = {n.pitch: n.finger for n in track.with_found_fingers().fingered().score.notes}
    for side, notes in enumerate((five, bass)):
        own = [n for n in notes if (f := searched[n.pitch]) is not None and f.hand == side]
        given = [fingers[note.pitch] for note in own]
        assert [f and f.index for f in given] == nearest_fingers(own, side, players)
        assert {f.hand for f in given if f is not None} == {side}
    silent = {pitch for pitch, finger in fingers.items() if finger is None}
    assert silent
    reasons = {each.note.pitch: each.reason for each in nearest.dropped or ()}
    assert reasons.keys() == silent
    assert all(reasons.values())


def test_the_performance_repeats_the_rehearsal():
    """Nothing is left for feedback to mend where nothing else is in the way."""
    agent = ICP()
    song = Score((*chord(72, end=0.3), *chord(76, start=0.3, end=0.6)))
    config = TaskConfig(initial_buffer_time=0.5, random_hand_position=0.02)
    task = PianoTask([song], config, SceneConfig(hands="right"))
    performance = play_episode(task, agent)
    assert performance.metrics["note_onset_f1"] == 1.0
    rehearsed = agent.planners[0].tracking
    np.testing.assert_array_equal(performance.episode["action"][:, :-1], rehearsed.ctrl)
    at_first = agent.planners[0].plan.nominal.tracking
    assert (rehearsed.ctrl != at_first.ctrl).any()
