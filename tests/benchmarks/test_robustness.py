"""The robustness benchmark: that disturbances are what they say."""

import numpy as np
from numpy.testing import assert_array_equal

from benchmarks.robustness import (
    DISTURBANCES,
    SCALED,
    Disturbance,
    disturbed_task,
    played_with,
    rows,
)
from cadenza.agents.agent import ZeroAgent
from cadenza.agents.playback import Playback
from cadenza.music.score import Note, Score
from cadenza.tasks.config import TaskConfig
from numbered import finger

TUNE = Score(
    (Note(0.0, 0.3, 72, finger=finger(1)), Note(0.3, 3.0, 76, finger=finger(3))), (), "A tune"
)


def test_the_model_is_off_by_as_much_and_differs_by_seed():
    task = disturbed_task(TUNE, TaskConfig(), Disturbance("", model=0.1))
    masses = []
    for seed in (0, 1):
        task.reset([np.random.default_rng(seed)], [0])
        assert task.drawn.keys() == {*SCALED, "seed"}
        masses.append(task.drawn["mass"].copy())
    assert 0.9 <= masses[0].min() < 0.92 < 1.08 < masses[0].max() <= 1.1
    assert (masses[0] != masses[1]).all()


def test_noise_alone_leaves_the_model():
    task = disturbed_task(TUNE, TaskConfig(), Disturbance("", noise=0.05))
    task.reset([np.random.default_rng(0)], [0])
    assert task.drawn.keys() == {"seed"}


def test_starts_differ_by_seed_and_recorded_plans_meet_them_unprepared():
    disturbance = Disturbance("", start=0.05)
    plan = played_with(TUNE, TaskConfig(), DISTURBANCES[0], ZeroAgent(), 0)[1]
    starts = []
    for seed in (0, 1):
        task = disturbed_task(TUNE, TaskConfig(), disturbance)
        task.reset([np.random.default_rng(seed)], [0])
        starts.append(task.state.hand_qpos[0].copy())
    assert np.abs(starts[0] - starts[1]).max() > 1e-3
    _, replayed = played_with(TUNE, TaskConfig(), disturbance, Playback(plan), 0)
    assert_array_equal(replayed, plan)


def test_a_row_for_each_disturbance():
    table = list(rows(TUNE, TaskConfig(), ZeroAgent, seeds=1))
    assert [row.split(" | ")[0] for row in table] == [
        disturbance.name for disturbance in DISTURBANCES
    ]
    assert all(row.count("|") == 5 for row in table)
