"""The comparison of planners: what counts as time for planning."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import planners
from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View


class Clock:
    """Goes on only where somebody thinks."""

    now = 0.0

    def perf_counter(self) -> float:
        return self.now


class Thinker(PlannerPerEnv["Begun"]):
    """Takes 10 s to begin, and 1 s for every action."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def begin(self, view: View, rng: np.random.Generator) -> Begun:
        self._clock.now += 10.0
        return Begun(self._clock)


class Begun(EpisodePlanner):
    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def act(self, view: View) -> Array:
        self._clock.now += 1.0
        return np.zeros(view.task.action_size)


def test_every_action_counts_and_a_beginning_by_its_share(monkeypatch):
    monkeypatch.setattr(planners, "time", clock := Clock())
    task = PianoTask(
        [Score((Note(0.0, 0.95, 60),))],
        TaskConfig(initial_buffer_time=0.0),
        SceneConfig(hands="right"),
    )
    result = planners.perform(Thinker(clock), task, num_steps=5, seed=0)
    assert task.goals.num_steps[0] == 20
    assert result.ratio == pytest.approx((10 * 5 / 20 + 5 * 1) / (5 * 0.05))
