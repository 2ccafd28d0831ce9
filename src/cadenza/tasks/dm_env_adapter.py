"""The task as a `dm_env.Environment`, for which the package has the extra `dm-env`."""

from __future__ import annotations

from typing import Any

import dm_env
import gymnasium
import numpy as np
from dm_env import specs
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.tasks.env import PianoEnv


class DmEnvAdapter(dm_env.Environment):
    """Wraps a `PianoEnv`, or what `gymnasium.make` makes of it.

    Observations are dictionaries of the parts of `observation_layout`.

    The last step of a score has discount 1, as in the published environment; one that ends on a
    wrong key or an unstable simulation has discount 0.
    """

    def __init__(self, env: gymnasium.Env, seed: int | None = None) -> None:
        """Adapt an environment of Gymnasium, which must observe no pixels.

        Args:
            env: the environment, without pixels and without wrappers that change observations.
            seed: the seed of the first episode; the following ones continue its random numbers.

        Raises:
            CadenzaError: observations are not those of a `PianoEnv`.
        """
        piano = env.unwrapped
        if not isinstance(piano, PianoEnv):
            raise CadenzaError(f"the dm_env adapter takes a PianoEnv, not {type(piano).__name__}")
        if piano.observation_space.shape is None:
            raise CadenzaError(
                "the dm_env adapter does not support pixels: make the environment without them"
            )
        if env.observation_space.shape != piano.observation_space.shape:
            raise CadenzaError(
                f"observations of shape {env.observation_space.shape}: leave out the wrapper that "
                "changes them; the dm_env adapter splits those of the environment into their parts"
            )
        self._env = env
        self._layout = piano.observation_layout
        self._seed = seed
        self._ended = True

    def reset(self) -> dm_env.TimeStep:
        """Start a new episode."""
        observation, _ = self._env.reset(seed=self._seed)
        self._seed, self._ended = None, False
        return dm_env.restart(self._parts(observation))

    def step(self, action: NDArray[Any]) -> dm_env.TimeStep:
        """Take a control step, or after the end of an episode a reset, as dm_env demands."""
        if self._ended:
            return self.reset()
        observation, reward, terminated, truncated, _ = self._env.step(np.asarray(action))
        self._ended = terminated or truncated
        parts = self._parts(observation)
        if terminated:
            return dm_env.termination(reward, parts)
        if truncated:
            return dm_env.truncation(reward, parts, discount=1.0)
        return dm_env.transition(reward, parts)

    def _parts(self, observation: NDArray[np.float32]) -> dict[str, NDArray[np.float32]]:
        return {name: observation[part] for name, part in self._layout.items()}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Name -> shape of each part of an observation."""
        return {
            name: specs.Array((part.stop - part.start,), np.float32, name)
            for name, part in self._layout.items()
        }

    def action_spec(self) -> specs.BoundedArray:
        """The specification of actions (A,) in [-1, 1], the pedal last."""
        shape = self._env.action_space.shape
        return specs.BoundedArray(shape, np.float32, -1.0, 1.0, "action")

    def close(self) -> None:
        """Free graphics."""
        self._env.close()
