"""Optimised presses and their tracking: the gains, that both pay, and that they repeat."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import solve_discrete_are

from cadenza.agents.agent import Agent, Array
from cadenza.agents.baselines.press_optimisation import regulator
from cadenza.agents.baselines.tracked_presses import TrackedPresses
from cadenza.agents.planner.config import TrackedPressesConfig
from cadenza.agents.playback import Playback
from cadenza.agents.rollout import EpisodeResult, play_episode
from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View

TUNE = Score((Note(0.0, 0.25, 66), Note(0.25, 0.5, 70), Note(0.5, 0.75, 78)), (), "A tune")


def task_of(score: Score = TUNE) -> PianoTask:
    return PianoTask([score], TaskConfig(initial_buffer_time=0.3), SceneConfig(hands="right"))


class Kept(TrackedPresses):
    """Plans once, for all episodes of one score."""

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        if not self.planners:
            super().reset(env_ids, rngs)


@pytest.fixture(scope="module")
def planned() -> tuple[Kept, EpisodeResult]:
    agent = Kept()
    return agent, play_episode(task_of(), agent)


def test_gains_are_those_of_the_linear_quadratic_regulator() -> None:
    rng = np.random.default_rng(0)
    n, m, steps = 6, 2, 300
    a, b = 0.4 * rng.standard_normal((n, n)), rng.standard_normal((n, m))
    root = rng.standard_normal((n, n))
    q, r = root @ root.T, 0.5 * np.eye(m)
    hessian = np.zeros((n + m, n + m))
    hessian[:n, :n], hessian[n:, n:] = q, r
    transition = np.concatenate([a, b], axis=1)
    gain = regulator(*(np.repeat(part[None], steps, axis=0) for part in (transition, hessian)))
    p = solve_discrete_are(a, b, q, r)
    assert_allclose(gain[0], -np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a), rtol=1e-8)


def test_presses_are_optimised_until_they_sound(planned: tuple[Kept, EpisodeResult]) -> None:
    assert planned[1].metrics["f1"] > 0.95


def test_nothing_is_corrected_where_all_goes_as_planned(
    planned: tuple[Kept, EpisodeResult],
) -> None:
    agent, performance = planned
    action = performance.episode.arrays["action"][:, :-1]
    assert_allclose(action, agent.planners[0].trajectories[0].ctrl, atol=1e-6)


class Pushed(Agent):
    """Another agent, whose actions are off by a push in one step."""

    def __init__(self, agent: Agent, push: Array, at: int) -> None:
        self._agent, self._push, self._at = agent, push, at
        self.reset = agent.reset

    def act(self, view: View) -> Array:
        action, task = self._agent.act(view), view.task
        if view.steps[0] != self._at:
            return action
        return np.clip(action + self._push, task.action_low, task.action_high)


def test_tracking_brings_pushed_hands_back(planned: tuple[Kept, EpisodeResult]) -> None:
    """Sooner than the servos by themselves, which the recorded actions leave it to."""
    agent, performance = planned
    expected, actions = (performance.episode.arrays[n] for n in ("fingertip_xpos", "action"))
    tracked, replayed = [], []
    for seed in range(4):
        push = 0.3 * np.random.default_rng(seed).standard_normal(actions.shape[1])
        push[-1], push[-3:-1] = 0.0, 0.1 * push[-3:-1]
        for player, found in ((agent, tracked), (Playback(actions), replayed)):
            episode = play_episode(task_of(), Pushed(player, push, at=3)).episode
            found.append(np.linalg.norm(episode.arrays["fingertip_xpos"] - expected, axis=-1)[5:9])
    assert np.mean(tracked) < 0.8 * np.mean(replayed)


def test_the_same_bits_again(planned: tuple[Kept, EpisodeResult]) -> None:
    again = play_episode(task_of(), TrackedPresses(), seed=5)  # nothing is random
    assert_array_equal(again.episode.arrays["action"], planned[1].episode.arrays["action"])


@pytest.mark.parametrize("iterations", [-1, np.nan])
def test_iterations_that_make_no_sense_are_refused(iterations: Any) -> None:
    with pytest.raises(CadenzaError, match="iterations"):
        TrackedPresses(TrackedPressesConfig(iterations=iterations))


def test_without_hands_there_is_nothing_to_plan() -> None:
    task = PianoTask([TUNE], TaskConfig(), SceneConfig(hands="none"))
    with pytest.raises(CadenzaError, match="hands"):
        play_episode(task, TrackedPresses())
