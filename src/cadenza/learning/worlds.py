"""Environments in which rollouts are collected, and those of the C engine."""

from __future__ import annotations

from typing import Any, Protocol

import jax
import numpy as np
from numpy.typing import NDArray

from cadenza.learning.collector import Collector, Finished
from cadenza.learning.learner import OnPolicyLearner
from cadenza.learning.rollout import Rollout

Array = Any  # of NumPy or of JAX


class Worlds(Protocol):
    """N environments in which rollouts are collected."""

    def begin(self) -> None:
        """Begins an episode in every environment."""

    def rollout(
        self, learner: OnPolicyLearner[Any], state: Any, num_steps: int, seed: int
    ) -> tuple[Rollout, list[Finished], dict[str, float]]:
        """Takes steps in every environment, with the policy of a learner's `state`.

        Returns:
            The rollout; the episodes that ended in it; and metrics by name.
        """

    def state(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """Returns the state as JSON and arrays, for `restore`."""

    def restore(self, plain: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> None:
        """Goes on from a state."""


class HostWorlds:
    """Environments of the C engine, as a `Collector` steps them."""

    def __init__(self, collector: Collector) -> None:
        self._collector = collector
        self.begin, self.state = collector.begin, collector.state
        self.restore = collector.restore

    def rollout(
        self, learner: OnPolicyLearner[Any], state: Any, num_steps: int, seed: int
    ) -> tuple[Rollout, list[Finished], dict[str, float]]:
        """Takes steps in every environment, see `Worlds`."""
        collector = self._collector
        finished: list[Finished] = []
        steps: list[tuple[Array, ...]] = []
        unstable = 0.0
        for key in jax.random.split(jax.random.key(seed), num_steps):
            observation = collector.observation
            decision = learner.act(state, observation, key)
            step = collector.step(np.tanh(np.asarray(decision.action)))
            value_at_end = np.zeros(len(observation), np.float32)
            if step.truncated.any():
                values = np.asarray(learner.value(state, step.final_observation))
                value_at_end = np.where(step.truncated, values, np.float32(0))
            reward = step.reward.astype(np.float32)
            steps.append((observation, *decision, reward, step.ended, value_at_end))
            finished += step.finished
            unstable += float(step.unstable.mean()) / num_steps
        parts = [np.stack([np.asarray(p) for p in part]) for part in zip(*steps, strict=True)]
        last = learner.value(state, collector.observation)
        return Rollout._make([*parts, last]), finished, {"unstable": unstable}
