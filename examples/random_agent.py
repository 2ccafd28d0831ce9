"""Plays an episode with random actions: the loop of Gymnasium.

python examples/random_agent.py [SONG]
"""

from __future__ import annotations

import sys

import cadenza  # noqa: F401 - registers the environments
import gymnasium as gym

song = sys.argv[1] if len(sys.argv) > 1 else "CMajorScaleOneHand"
env = gym.make("cadenza/Piano-v0", song=song)
env.action_space.seed(0)
observation, info = env.reset(seed=0)
print(f"{info['song']}: observations {observation.shape}, actions {env.action_space.shape}")

total, ended = 0.0, False
while not ended:
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    total += reward
    ended = terminated or truncated
print(f"return {total:.2f}, F1 {info['metrics/f1']:.3f}")
env.close()
