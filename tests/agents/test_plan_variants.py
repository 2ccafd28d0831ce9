"""Variants and trajectories spliced from them: of each passage, what loses less is kept."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cadenza.agents.planner.practice.plan_variants import (
    Passage,
    SplicedTrajectory,
    Variant,
    better_windows,
    passages_of,
    spliced,
)
from cadenza.agents.planner.practice.trajectory import Trajectory
from cadenza.fingering.transitions import Costs
from cadenza.fingers import NO_FINGER, Finger
from cadenza.music.score import Note, Score
from cadenza.scene.scene import build_scene
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.goal_track import GoalTrack

THUMB, INDEX, LEFT_THUMB = 0, 1, 5
SONG = Score(tuple(Note(0.5 * i, 0.5 * i + 0.4, 60 + i % 7, 80, Finger(0, 0)) for i in range(16)))
TRACK = GoalTrack(SONG, (), TaskConfig(initial_buffer_time=0.5), build_scene(), searched=True)
STEPS = TRACK.goals.num_steps
STRIKES = [TRACK.first_step(note) for note in SONG.notes]
USUAL = Variant(np.full(len(SONG.notes), THUMB), np.zeros((STEPS, 2), np.int8))
EVERYTHING = slice(STEPS)


def with_index(*notes: int) -> Variant:
    fingers = USUAL.fingers.copy()
    fingers[list(notes)] = INDEX
    return USUAL._replace(fingers=fingers)


def lost(where: slice, much: float = 1.0) -> np.ndarray:
    loss = np.zeros((STEPS, 2))
    loss[where] = much
    return loss


SERVOS = [TRACK.scene.servos_on(side) for side in TRACK.scene.sides]
GOALS: Any = [SimpleNamespace(keys=np.zeros((STEPS, 88), bool))] * 2


def played(loss: np.ndarray, ctrl: float = 0.0) -> Trajectory:
    """A trajectory with this loss, and the same control for all servos."""
    servos = SERVOS[-1].stop
    return Trajectory(
        np.full((STEPS, servos), ctrl),
        np.zeros((STEPS, servos, 2)),
        np.zeros((STEPS, 88), bool),
        *np.full((2, STEPS, 88), np.nan, np.float32),
        loss,
        np.zeros_like(loss, int),
        np.zeros_like(loss),
        np.zeros(STEPS),
    )


def judged(passages: list[Passage], hand: int) -> list[int]:
    """The steps in which a hand is judged."""
    return [
        step for steps, hands in passages if [0, 1][hands].count(hand) for step in range(999)[steps]
    ]


@given(st.sets(st.integers(0, len(SONG.notes) - 1)))
def test_each_note_with_another_finger_is_in_one_passage(notes):
    passages = passages_of(TRACK, USUAL, with_index(*notes))
    for hand in (0, 1):
        steps = judged(passages, hand)
        assert len(steps) == len(set(steps))
        assert {STRIKES[i] for i in notes} <= set(steps)
    assert bool(passages) == bool(notes)


def test_of_each_passage_the_fingers_are_kept_that_lose_less():
    other = with_index(1, 2, 12)
    early, late = passages_of(TRACK, USUAL, other)
    loss, other_loss = lost(EVERYTHING, 0.1), lost(EVERYTHING, 0.1)
    other_loss[early], other_loss[late] = 0.2, 0.0
    best = SplicedTrajectory(TRACK, USUAL, played(loss)).with_better(
        other, played(other_loss, 1.0), GOALS
    )
    assert best.variant.equals(with_index(12))
    assert best.trajectory.loss.sum() == pytest.approx(loss.sum() - loss[late].sum())
    theirs = np.zeros(STEPS, bool)
    theirs[late[0]] = True
    assert (best.trajectory.ctrl == theirs[:, None]).all()
    assert loss.all()  # is as it was


def test_where_fingers_are_the_same_each_second_of_a_hand_is_kept_that_loses_less():
    other = with_index(6)
    ((refingered, _),) = passages_of(TRACK, USUAL, other)
    loss = lost(EVERYTHING, 0.1)
    for hand in (0, 1):
        other_loss = lost(EVERYTHING, 0.2)
        other_loss[:, hand] = 0.0
        best = SplicedTrajectory(TRACK, USUAL, played(loss)).with_better(
            other, played(other_loss, 1.0), GOALS
        )
        assert best.variant.equals(USUAL)  # as both hands together lose more
        same = (best.trajectory.loss[:, hand] > 0).nonzero()[0]
        # Fingers are those of the right hand.
        assert same.size == 0 if hand else set(range(STEPS)[refingered]) <= set(same.tolist())
        assert len(same) < STEPS // 2
        np.testing.assert_array_equal(best.trajectory.loss[:, 1 - hand], loss[:, 1 - hand])
        theirs = best.trajectory.loss[:, hand] == 0
        assert (best.trajectory.ctrl[:, SERVOS[hand]] == theirs[:, None]).all()


def test_a_note_without_a_finger_is_of_no_hand():
    other, loss = USUAL._replace(fingers=USUAL.fingers.copy()), lost(EVERYTHING, 0.1)
    other.fingers[6] = NO_FINGER
    ((steps, _),) = passages_of(TRACK, USUAL, other)
    other_loss = lost(EVERYTHING, 0.0)
    other_loss[steps] = 1.0
    best = SplicedTrajectory(TRACK, USUAL, played(loss)).with_better(
        other, played(other_loss), GOALS
    )
    assert (best.trajectory.loss[steps, 0] == 0.1).all()  # of the hand that plays it otherwise
    other_loss[steps] = [1.0, 0.0]
    best = SplicedTrajectory(TRACK, USUAL, played(loss)).with_better(
        other, played(other_loss), GOALS
    )
    assert not best.trajectory.loss[:, 1].any()


def test_other_fingers_are_looked_for_only_where_something_is_lost():
    other_costs = Costs(distance=64.0, same_finger=0.0)
    nowhere = SplicedTrajectory(TRACK, USUAL, played(lost(slice(0))))
    assert nowhere.with_fingers_by(other_costs).equals(USUAL)
    everywhere = SplicedTrajectory(TRACK, USUAL, played(lost(EVERYTHING))).with_fingers_by(
        other_costs
    )
    assert not everywhere.equals(USUAL)
    at_the_end = SplicedTrajectory(TRACK, USUAL, played(lost(slice(STEPS - 3, STEPS))))
    changed = at_the_end.with_fingers_by(other_costs)
    loss = at_the_end.trajectory.loss
    assert all(loss[passage].any() for passage in passages_of(TRACK, USUAL, changed))


def test_of_each_jump_the_time_to_let_go_is_kept_that_loses_less():
    loss = lost(EVERYTHING, 0.1)
    later = SplicedTrajectory(TRACK, USUAL, played(loss)).with_release_delay(1)
    assert (later.release_delays[STRIKES, 0] == 1).all()
    assert not later.release_delays[:, 1].any()  # which plays nothing
    passages = passages_of(TRACK, USUAL, later)
    assert len(passages) == len(STRIKES)
    other_loss = loss.copy()
    other_loss[passages[3]] = 0.0
    other_loss[passages[4]] = 0.2
    best = SplicedTrajectory(TRACK, USUAL, played(loss)).with_better(
        later, played(other_loss), GOALS
    )
    assert np.flatnonzero(best.variant.release_delays[STRIKES, 0]).tolist() == [3]
    assert best.with_release_delay(2).equals(best.variant)  # nothing is lost there any more


def test_a_hand_lets_go_later_only_where_it_loses_something():
    third = slice(STRIKES[3] - 1, STRIKES[3] + 1)
    best = SplicedTrajectory(TRACK, USUAL, played(lost(third)))
    assert np.flatnonzero(best.with_release_delay(1).release_delays[STRIKES, 0]).tolist() == [3]
    assert best.with_release_delay(2).equals(USUAL)  # one step has not been tried
    other_hand = USUAL._replace(fingers=np.full(len(SONG.notes), LEFT_THUMB))
    changed = best._replace(variant=other_hand).with_release_delay(1)
    assert changed.release_delays[STRIKES[3]].tolist() == [0, 1]


def test_a_variant_gives_the_track_its_fingers():
    fingers = [note.finger for note in with_index(3, 4).of(TRACK).score.notes]
    assert fingers == [Finger(0, int(i in (3, 4))) for i in range(len(SONG.notes))]


# Splicing

SHORT, KEYS, WINDOW = 23, 5, 4


class Goals:
    """What a hand has to do: every other key."""

    def __init__(self, hand: int) -> None:
        self.keys = np.zeros((SHORT, KEYS), bool)
        self.keys[:, hand::2] = True


def drawn(rng: np.random.Generator) -> Trajectory:
    return Trajectory(
        rng.random((SHORT, 6)),
        rng.random((SHORT, 6, 2)),
        rng.random((SHORT, KEYS)) < 0.5,
        *rng.random((2, SHORT, KEYS), np.float32),
        rng.choice([0.0, 0.5, 1.0], (SHORT, 2)),
        rng.integers(3, size=(SHORT, 2)),
        rng.random((SHORT, 2)),
        rng.random(SHORT),
    )


@pytest.mark.parametrize("seed", range(5))
def test_each_hand_keeps_the_better_of_each_window(seed):
    goals: Any = [Goals(0), Goals(1)]
    own = [slice(0, 3), slice(3, 6)]
    rng = np.random.default_rng(seed)
    one, other = drawn(rng), drawn(rng)
    before = one.copied()
    excluded = rng.random((SHORT, 2)) < 0.05
    where = better_windows(one.loss, other.loss, excluded, WINDOW)
    best = spliced(one, other, where, goals, own)
    for begin in range(0, SHORT, WINDOW):
        rows = slice(begin, begin + WINDOW)
        for hand, servos in enumerate(own):
            theirs = other.loss[rows, hand].sum() < one.loss[rows, hand].sum()
            kept = other if theirs and not excluded[rows, hand].any() else one
            for name in ("ctrl", "expected"):
                there, expected = (getattr(each, name)[rows, servos] for each in (best, kept))
                np.testing.assert_array_equal(there, expected)
            for name in ("loss", "faults", "strike_loss"):
                there, expected = (getattr(each, name)[rows, hand] for each in (best, kept))
                np.testing.assert_array_equal(there, expected)
            own_keys = goals[hand].keys[0]
            for name in ("sounding", "onset", "offset"):
                there, expected = (getattr(each, name)[rows, own_keys] for each in (best, kept))
                np.testing.assert_array_equal(there, expected)
    for was, now in zip(before, one, strict=True):
        np.testing.assert_array_equal(was, now)  # the trajectories stay as they are
