"""Trains a policy with brax's PPO, on the device; the environment fits MuJoCo Playground, too.

python examples/train_with_brax.py [SONG] [STEPS] [WORLDS]
"""

from __future__ import annotations

import sys

from brax.training.agents.ppo.train import train
from cadenza.tasks.playground import PlaygroundPiano

song, steps, worlds = (sys.argv[1:] + ["OdeToJoy", "100_000_000", "4096"][len(sys.argv) - 1 :])[:3]
env = PlaygroundPiano(song)
train(
    env,
    num_timesteps=int(steps),
    episode_length=env.episode_length,
    num_envs=int(worlds),
    num_eval_envs=min(128, int(worlds)),
    num_evals=2,
    batch_size=int(worlds),
    num_minibatches=1,
    unroll_length=10,
    num_updates_per_batch=4,
    normalize_observations=True,
    discounting=0.8,
    learning_rate=3e-4,
    entropy_cost=1e-3,
    progress_fn=lambda step, metrics: print(
        f"{step} steps: return {metrics['eval/episode_reward']:.2f}, "
        f"F1 {metrics['eval/episode_f1']:.3f}"
    ),
)
