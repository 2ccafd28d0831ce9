"""Rollouts of the task on JAX's device; no array crosses to the host within one."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from cadenza.learning.algorithms.on_jax import from_arrays, to_arrays
from cadenza.learning.collector import Finished
from cadenza.learning.config import TrainingConfig
from cadenza.learning.env_rollout import EnvRollout
from cadenza.learning.experience import Chunk
from cadenza.learning.learner import OnPolicyLearner
from cadenza.learning.observation import Inputs
from cadenza.learning.on_policy import MAX_SEED, RolloutExperience
from cadenza.learning.ranges import Ranges
from cadenza.resumable import Arrays
from cadenza.tasks.functional import FunctionalPianoTask, PianoState

Array = Any  # of JAX


class _DeviceProgress(NamedTuple):
    """N environments, and what their episodes have earned so far."""

    worlds: PianoState
    returns: Array  # (N,)


class _Ends(NamedTuple):
    """How T steps of N environments ended, (T, N) each."""

    ended: Array
    f1: Array
    returns: Array
    unstable: Array


class DeviceRollouts(RolloutExperience):
    """Rollouts in the environments of a `FunctionalPianoTask`."""

    def __init__(
        self,
        config: TrainingConfig,
        task: FunctionalPianoTask,
        inputs: Inputs,
        ranges: Ranges | None,
        rng: np.random.Generator,
        sample_rng: np.random.Generator,
    ) -> None:
        """Begin no episode yet.

        The policy observes `inputs`, all from the task's observation. `ranges` scale joints and
        actions; None leaves the task's scale. Environments draw from `rng`; for `sample_rng` see
        `RolloutExperience`.
        """
        super().__init__(config, sample_rng)
        self._task, self._ranges = task, ranges
        self._kept = np.array(inputs.kept)
        self._joints = task.spec.observation_layout.get("joints", slice(0, 0))
        self._key = jax.random.key(int(rng.integers(MAX_SEED)))
        self._collect = jax.jit(
            self._rollout, static_argnames=("learner", "num_steps"), donate_argnames="progress"
        )

    def begin(self) -> None:
        self._progress = self._begun(self._key)

    def _begun(self, key: Array) -> _DeviceProgress:
        return _DeviceProgress(self._task.reset(key), jnp.zeros(self._task.num_envs))

    def rollout(
        self, learner: OnPolicyLearner[Any], state: Any, num_steps: int, seed: int
    ) -> tuple[EnvRollout, list[Finished], dict[str, float]]:
        self._progress, rollout, ends = self._collect(
            learner, state, self._progress, num_steps, jax.random.key(seed)
        )
        ended, f1, returns, unstable = (np.asarray(values) for values in ends)
        scores = zip(f1[ended].tolist(), returns[ended].tolist(), strict=True)
        finished = [Finished(f1, math.nan, total) for f1, total in scores]
        return rollout, finished, {"unstable": float(unstable.mean())}

    def _rollout(
        self,
        learner: OnPolicyLearner[Any],
        state: Any,
        progress: _DeviceProgress,
        num_steps: int,
        key: Array,
    ) -> tuple[_DeviceProgress, EnvRollout, _Ends]:
        def step(
            progress: _DeviceProgress, key: Array
        ) -> tuple[_DeviceProgress, tuple[Any, _Ends]]:
            observation = self._observed(progress.worlds.obs)
            decision = learner.act(state, observation, key)
            action = self._action(jnp.tanh(decision.action), progress.worlds.obs)
            worlds = self._task.step(progress.worlds, action)
            info, ended = worlds.info, worlds.done
            value = learner.value(state, self._observed(info["final_obs"]))
            value_at_end = jnp.where(info["truncation"], value, 0.0)
            returns = progress.returns + worlds.reward
            part = (observation, *decision, worlds.reward, ended, value_at_end)
            ends = _Ends(ended, worlds.metrics["f1"], returns, info["unstable"])
            return _DeviceProgress(worlds, jnp.where(ended, 0.0, returns)), (part, ends)

        progress, (parts, ends) = jax.lax.scan(step, progress, jax.random.split(key, num_steps))
        last = learner.value(state, self._observed(progress.worlds.obs))
        return progress, EnvRollout._make([*parts, last]), ends

    def _observed(self, observation: Array) -> Array:
        """The policy's observations, from the task's observations (N, D)."""
        if self._ranges is not None:
            joints = self._ranges.scaled(observation[:, self._joints])
            observation = observation.at[:, self._joints].set(joints)
        return observation[:, self._kept]

    def _action(self, action: Array, observation: Array) -> Array:
        """The task's actions from the policy's actions, both (N, A) in [-1, 1].

        The pedal is the score's, as in `ActionMapping`: in `observation` (N, D) it comes after the
        keys of the next step.
        """
        if self._ranges is not None:
            action = self._task.spec.unscale_action(self._ranges.ctrl(action))
        if self._task.config.sustain_term:
            return action
        down = observation[:, self._task.scene.keyboard.num_keys] > 0
        return action.at[:, -1].set(jnp.where(down, 1.0, -1.0))

    # To go on later

    def state(self) -> tuple[dict[str, Any], Arrays]:
        return {}, to_arrays(_with_key_data(self._progress))

    def restore(self, plain: dict[str, Any], arrays: Arrays, chunks: Sequence[Chunk]) -> None:
        like = jax.eval_shape(lambda: _with_key_data(self._begun(self._key)))
        progress = from_arrays(arrays, like)
        key = jax.random.wrap_key_data(progress.worlds.key)
        self._progress = progress._replace(worlds=progress.worlds._replace(key=key))


def _with_key_data(progress: _DeviceProgress) -> _DeviceProgress:
    """The same with a key that can be written to a file."""
    data = jax.random.key_data(progress.worlds.key)
    return progress._replace(worlds=progress.worlds._replace(key=data))
