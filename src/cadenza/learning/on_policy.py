"""Experience of the latest policy only: a round learns from the rollout that it begins with."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from cadenza.learning.collector import Collector, Finished
from cadenza.learning.config import TrainingConfig
from cadenza.learning.env_rollout import EnvRollout
from cadenza.learning.experience import Chunk, Round
from cadenza.learning.learner import OnPolicyLearner
from cadenza.resumable import Arrays

Array = Any  # of NumPy or of JAX

MAX_SEED = 2**31


class RolloutExperience(ABC):
    """`Experience` by rollouts, on CPU cores or all on one device."""

    def __init__(self, config: TrainingConfig, sample_rng: np.random.Generator) -> None:
        """Draw the seeds of rollouts and the order of learning from `sample_rng`."""
        self._config, self._sample_rng = config, sample_rng

    @abstractmethod
    def rollout(
        self, learner: OnPolicyLearner[Any], state: Any, num_steps: int, seed: int
    ) -> tuple[EnvRollout, list[Finished], dict[str, float]]:
        """Take steps in every environment, with the policy of a learner's `state`.

        Returns the rollout; the episodes that ended in it; and metrics by name.
        """

    def round(self, learner: OnPolicyLearner[Any], state: Any, step: int) -> Round:
        config = self._config
        seed = int(self._sample_rng.integers(MAX_SEED))
        rollout, finished, more = self.rollout(learner, state, config.train_freq, seed)
        state, metrics = learner.update(state, rollout, self._rows())
        metrics |= {name: np.full(config.gradient_steps, value) for name, value in more.items()}
        return state, metrics, finished

    def _rows(self) -> NDArray[np.int32]:
        """Minibatches (U, B) of rows of a rollout, each used equally often (+-1)."""
        config = self._config
        steps = config.train_freq * config.num_envs
        num_rows = config.gradient_steps * config.learner.batch_size
        passes = -(-num_rows // steps)
        orders = np.concatenate([self._sample_rng.permutation(steps) for _ in range(passes)])
        return orders[:num_rows].reshape(config.gradient_steps, -1).astype(np.int32)

    def save(self, step: int) -> tuple[Chunk, ...]:
        """Write nothing: the rollout has been learnt from."""
        return ()

    def drop_unneeded(self) -> None:  # noqa: B027 - the protocol's
        """Delete nothing, as nothing was written."""


class HostRollouts(RolloutExperience):
    """Rollouts in the C engine, as a `Collector` steps its environments."""

    def __init__(
        self, config: TrainingConfig, collector: Collector, sample_rng: np.random.Generator
    ) -> None:
        super().__init__(config, sample_rng)
        self._collector = collector
        self.begin, self.state = collector.begin, collector.state

    def rollout(
        self, learner: OnPolicyLearner[Any], state: Any, num_steps: int, seed: int
    ) -> tuple[EnvRollout, list[Finished], dict[str, float]]:
        collector = self._collector
        finished: list[Finished] = []
        steps: list[tuple[Array, ...]] = []
        unstable = 0.0
        for key in jax.random.split(jax.random.key(seed), num_steps):
            observation = collector.observation
            decision = learner.act(state, observation, key)
            result, final, ended = collector.step(np.tanh(np.asarray(decision.action)))
            value_at_end = np.zeros(len(observation), np.float32)
            if result.truncated.any():
                values = np.asarray(learner.value(state, final))
                value_at_end = np.where(result.truncated, values, np.float32(0))
            reward, over = result.reward.astype(np.float32), result.terminated | result.truncated
            steps.append((observation, *decision, reward, over, value_at_end))
            finished += ended
            unstable += float(result.unstable.mean()) / num_steps
        parts = [np.stack([np.asarray(p) for p in part]) for part in zip(*steps, strict=True)]
        last = learner.value(state, collector.observation)
        return EnvRollout._make([*parts, last]), finished, {"unstable": unstable}

    def restore(self, plain: dict[str, Any], arrays: Arrays, chunks: Sequence[Chunk]) -> None:
        self._collector.restore(plain, arrays)
