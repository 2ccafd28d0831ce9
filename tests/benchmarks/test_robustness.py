"""The robustness benchmark: that trouble is what it says, for whom it says."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_array_equal

from benchmarks.robustness import TROUBLES, Trouble, f1_in_trouble, rows, troubled_task
from cadenza.agents.agent import ZeroAgent
from cadenza.agents.playback import Playback
from cadenza.music.score import Note, Score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from numbered import finger

TUNE = Score(
    (Note(0.0, 0.3, 72, finger=finger(1)), Note(0.3, 3.0, 76, finger=finger(3))), (), "A tune"
)


def test_the_planner_is_not_told_of_the_model() -> None:
    task = troubled_task(TUNE, TaskConfig(), Trouble("", model=0.1), 0)
    nominal = PianoTask([TUNE])
    assert task.scene.config == nominal.scene.config
    assert (task.scene.model.body_mass != nominal.scene.model.body_mass).any()


def test_starts_differ_by_seed_and_recorded_plans_meet_them_unprepared() -> None:
    trouble = Trouble("", start=0.05)
    plan = f1_in_trouble(TUNE, TaskConfig(), TROUBLES[0], ZeroAgent(), 0)[1]
    starts = []
    for seed in (0, 1):
        task = troubled_task(TUNE, TaskConfig(), trouble, seed)
        task.reset([np.random.default_rng(seed)], [0])
        starts.append(task.state.hand_qpos[0].copy())
    assert np.abs(starts[0] - starts[1]).max() > 1e-3
    _, replayed = f1_in_trouble(TUNE, TaskConfig(), trouble, Playback(plan), 0)
    assert_array_equal(replayed, plan)


def test_a_row_for_each_trouble() -> None:
    table = list(rows(TUNE, TaskConfig(), ZeroAgent, seeds=1))
    assert [row.split(" | ")[0] for row in table] == [trouble.name for trouble in TROUBLES]
    assert all(row.count("|") == 5 for row in table)
