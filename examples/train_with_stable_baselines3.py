"""Trains Stable-Baselines3's SAC on the environments, single and vectorised.

The single environment is used as it is; `VecEnvAdapter` gives the vectorised one the interface that
Stable-Baselines3 has for such. Stable-Baselines3 installs gigabytes; this gives it a virtual
environment of its own, tests this program there, and runs it:

    make sb3
    .venv-sb3/bin/python examples/train_with_stable_baselines3.py --steps 4000
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from typing import Any

import cadenza  # noqa: F401 - registers the environments
import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3 import SAC
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv, VecMonitor

SONG = "cadenza/CMajorScaleOneHand-v0"


class VecEnvAdapter(VecEnv):
    """Gymnasium's vector environment, made with `AutoresetMode.SAME_STEP`, as a `VecEnv`."""

    def __init__(self, envs: VectorEnv) -> None:
        self._envs = envs  # the constructor below asks for its attributes
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> np.ndarray:
        seed = self._seeds[0]
        self._reset_seeds()
        return self._envs.reset(seed=seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observation, reward, terminated, truncated, infos = self._envs.step(self._actions)
        each: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for env in np.flatnonzero(terminated | truncated):
            each[env] = {
                "terminal_observation": infos["final_obs"][env],
                "TimeLimit.truncated": bool(truncated[env] and not terminated[env]),
            }
        return observation, reward, terminated | truncated, each

    def close(self) -> None:
        self._envs.close()

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self._envs, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, **kwargs: Any) -> list[Any]:
        raise NotImplementedError


def train(name: str, envs: Any, steps: int, options: dict[str, Any]) -> None:
    """Trains for `steps` control steps, and prints how it went."""
    model = SAC(
        "MlpPolicy",
        envs,
        gamma=0.84,
        ent_coef="auto_0.05",
        learning_starts=1000,
        policy_kwargs={"net_arch": [256, 256, 256]},
        seed=0,
        device="cpu",
        stats_window_size=steps,  # keeps the returns of all episodes
        **options,
    )
    started = time.perf_counter()
    model.learn(steps, log_interval=None)
    took = time.perf_counter() - started
    returns: Sequence[float] = [episode["r"] for episode in model.ep_info_buffer or ()]
    print(
        f"{name}: {model.num_timesteps} steps in {took:.0f} s; returns of the first three episodes "
        f"{np.round(returns[:3], 1).tolist()}, last three {np.round(returns[-3:], 1).tolist()}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--steps", type=int, default=4000)
    steps = parser.parse_args().steps
    train("gym.make", Monitor(gym.make(SONG)), steps, {})
    vector = gym.make_vec(SONG, num_envs=8, autoreset_mode=AutoresetMode.SAME_STEP)
    train("gym.make_vec", VecMonitor(VecEnvAdapter(vector)), steps, {"gradient_steps": 8})


if __name__ == "__main__":
    main()
