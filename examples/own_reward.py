"""Adds a term to the reward: a price for every wrong key.

python examples/own_reward.py [SONG]
"""

from __future__ import annotations

import sys

import cadenza
import gymnasium as gym
import numpy as np


def wrong_keys(outcome: cadenza.Outcome) -> np.ndarray:
    """(N,) minus 0.1 for each key that sounds and should not."""
    wrong = outcome.sounding & ~outcome.goal_keys
    return -0.1 * wrong.sum(axis=1)


song = sys.argv[1] if len(sys.argv) > 1 else "CMajorScaleOneHand"
envs = gym.make_vec(
    "cadenza/Piano-v0", num_envs=4, song=song, reward_terms={"wrong_keys": wrong_keys}
)
envs.action_space.seed(0)
envs.reset(seed=0)
total = np.zeros(4)
terms: dict[str, np.ndarray] = {}
for _ in range(100):
    _, rewards, _, _, infos = envs.step(envs.action_space.sample())
    total += rewards
    for name, values in infos.items():
        if name.startswith("reward/"):
            terms[name] = terms.get(name, 0) + values

print("over 100 steps, in each environment:")
for name, values in {**terms, "their sum": total}.items():
    print(f"{name:18}", values.round(1))
envs.close()
