"""A training loop as people write it for RoboPianist. Only its import differs.

python examples/from_robopianist.py [SONG.mid]
"""

from __future__ import annotations

import sys

import numpy as np
from cadenza.tasks import dm_env_adapter as suite  # was: from robopianist import suite

EPISODES = 2

env = suite.load(
    environment_name="RoboPianist-debug-CMajorScaleTwoHands-v0",
    midi_file=sys.argv[1] if len(sys.argv) > 1 else None,
    seed=42,
    task_kwargs={
        "n_steps_lookahead": 10,
        "trim_silence": True,
        "gravity_compensation": True,
        "reduced_action_space": True,
        "primitive_fingertip_collisions": True,
        "control_timestep": 0.05,
        "wrong_press_termination": False,
        "disable_fingering_reward": False,
        "disable_forearm_reward": False,
        "disable_colorization": False,
        "disable_hand_collisions": False,
        "change_color_on_activation": True,
        "augmentations": None,
    },
)
spec = env.action_spec()
print(f"{spec.shape[0]} actions, the last is {spec.name.split()[-1]}")
print("observations:", {name: part.shape for name, part in env.observation_spec().items()})


def policy(observation: dict[str, np.ndarray]) -> np.ndarray:
    """Random actions; yours goes here."""
    assert observation.keys() == env.observation_spec().keys()
    return env.random_state.uniform(spec.minimum, spec.maximum)


for _ in range(EPISODES):
    timestep = env.reset()
    while not timestep.last():
        timestep = env.step(policy(timestep.observation))
    print(env.get_statistics() | env.get_musical_metrics())
