"""Trains a policy with rsl_rl's PPO on the CPU; with engine="warp" it stays on a GPU.

python examples/train_with_rsl_rl.py [SONG] [ITERATIONS] [WORLDS]
"""

from __future__ import annotations

import sys

import cadenza  # noqa: F401 - registers the environments
import gymnasium as gym
from cadenza.tasks.rsl_rl_adapter import RslRlPiano
from gymnasium.vector import AutoresetMode
from rsl_rl.runners import OnPolicyRunner

defaults = ["CMajorScaleOneHand", "100", "16"]
song, iterations, worlds = (sys.argv[1:] + defaults[len(sys.argv) - 1 :])[:3]
envs = gym.make_vec(
    "cadenza/Piano-v0",
    num_envs=int(worlds),
    song=song,
    hands="right",
    n_steps_lookahead=10,
    physics="fast",
    autoreset_mode=AutoresetMode.SAME_STEP,  # without it with engine="warp", which knows no other
)
env = RslRlPiano(envs)
network = {
    "class_name": "MLPModel",
    "hidden_dims": [256, 256, 256],
    "activation": "elu",
    "obs_normalization": True,
}
gaussian = {"class_name": "GaussianDistribution", "init_std": 0.5}
settings = {
    "num_steps_per_env": 32,
    "save_interval": 100,
    "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
    "actor": network | {"distribution_cfg": gaussian},
    "critic": network,
    "algorithm": {
        "class_name": "PPO",
        "learning_rate": 3e-4,
        "gamma": 0.8,
        "lam": 0.9,
        "num_mini_batches": 4,
        "entropy_coef": 1e-3,
        "rnd_cfg": None,
    },
}
runner = OnPolicyRunner(env, settings, log_dir="run", device=str(env.device))
runner.learn(int(iterations))
