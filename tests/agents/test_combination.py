"""Plans that are put together finger by finger."""

from __future__ import annotations

import numpy as np
import pytest

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.search.candidates import combined
from cadenza.agents.planner.search.horizon_cost import HorizonCost, Rollout
from cadenza.keyboards.piano import PIANO
from cadenza.music.score import Note, Score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask

FINGER = np.array([-1, 0, 0, 1, -1, 2])
CHORD = 64, 67, 72


@pytest.mark.parametrize("seed", range(20))
def test_each_finger_does_what_it_does_best(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plans = rng.standard_normal((6, 7, len(FINGER)))
    costs = [rng.exponential(1.0, (rng.integers(1, 8), 3)) for _ in plans]
    best = int(rng.integers(len(plans)))
    costs[best] = rng.exponential(1.0, (7, 3))
    expected = plans[best].copy()
    for finger in range(3):
        won = {
            i: costs[best][: len(cost), finger].sum() - cost[:, finger].sum()
            for i, cost in enumerate(costs)
            if len(cost) >= 3  # fewer steps do not show enough
        }
        chosen = max(won, key=lambda i: won[i])
        if won[chosen] > 0.15:
            expected[:, finger == FINGER] = plans[chosen][:, finger == FINGER]
    plan = combined(plans, costs, best, FINGER)
    if (expected == plans[best]).all():
        assert not len(plan)
    else:
        np.testing.assert_array_equal(plan, expected[None])


def test_the_hand_goes_where_the_best_plan_has_it() -> None:
    plans = np.arange(2.0)[:, None, None] * np.ones((2, 7, len(FINGER)))
    costs = [np.full((7, 3), 1.0), np.zeros((7, 3))]
    np.testing.assert_array_equal(combined(plans, costs, 0, FINGER)[0, 0], FINGER >= 0)


class Chord:
    """Of three notes, and a trial of it in which the fingertips are where they should be."""

    def __init__(self) -> None:
        notes = tuple(Note(0.0, 0.5, pitch, 80) for pitch in CHORD)
        task = PianoTask([Score(notes)], TaskConfig(initial_buffer_time=0.5))
        (track,) = task.tracks
        plan = plan_song(track.with_found_fingers(), task.state.hand_qpos[0])
        task.close()
        self.part = HandGoals(plan, "right")
        self.rows = np.flatnonzero(plan.goals.keys.any(axis=1))
        self.tips = self.part.fingertips[self.rows + 1]
        self.ahead = HorizonCost(self.part, self.rows, PIANO, slice(None), np.zeros(88))
        self.wanted = plan.goals.keys[self.rows]

    def trial(self, depth: Array) -> Rollout:
        """In which keys are (H, 88) of their travel down."""
        key_qpos, sounding, costs = depth * PIANO.travel, np.zeros(88, bool), list[float]()
        for k, (keys, tips) in enumerate(zip(key_qpos, self.tips, strict=True)):
            cost, _, sounding = self.ahead.cost(k, keys, tips, sounding)
            costs.append(cost)
        return Rollout(sum(costs), 0, costs, list(self.tips), [], list(key_qpos))


def test_what_fingers_cost_is_what_the_trial_costs() -> None:
    chord = Chord()
    for seed in range(10):
        trial = chord.trial(np.random.default_rng(seed).uniform(0.0, 1.2, chord.wanted.shape))
        costs = chord.ahead.by_finger(trial)
        assert costs.shape == chord.tips.shape[:2]
        np.testing.assert_allclose(costs.sum(axis=1), trial.steps)


def test_a_silent_key_is_the_fault_of_the_finger_that_is_asked_for_it() -> None:
    chord, key = Chord(), CHORD[1] - PIANO.lowest_pitch
    depth = chord.wanted.astype(float)
    fine = chord.ahead.by_finger(chord.trial(depth))
    depth[:, key] = 0.0
    worse = chord.ahead.by_finger(chord.trial(depth)) > fine
    finger = chord.part.asked[chord.rows[0], key]
    assert (worse == (np.arange(worse.shape[1]) == finger)).all()


def test_a_wrong_key_is_the_fault_of_the_finger_over_it() -> None:
    chord, finger = Chord(), 4
    depth = chord.wanted.astype(float)
    fine = chord.ahead.by_finger(chord.trial(depth))
    chord.tips[:, finger] = PIANO.centre[CHORD[-1] - PIANO.lowest_pitch + 4]
    depth[:, CHORD[-1] - PIANO.lowest_pitch + 4] = 1.0
    worse = chord.ahead.by_finger(chord.trial(depth)) > fine + 2.0
    assert (worse == (np.arange(worse.shape[1]) == finger)).all()
