"""Has the planner play several songs, and writes all steps to one file of arrays.

python examples/make_dataset.py [dataset.npz] [SONG ...]

Every array has a row per control step: an action, and the state and the goal after it. `episode`
counts the songs, so that `episode == 0` selects the first. `cadenza.Episode` describes the others.
"""

from __future__ import annotations

import sys

import cadenza
import numpy as np

ARRAYS = ("hand_qpos", "hand_qvel", "key_qpos", "goal_keys", "goal_fingers", "action")

path = sys.argv[1] if len(sys.argv) > 1 else "dataset.npz"
songs = sys.argv[2:] or ["CMajorScaleOneHand", "OdeToJoy"]

episodes = []
for song in songs:
    performance = cadenza.play(song)
    episodes.append(performance.episode)
    print(f"{song}: {performance.episode.num_steps} steps, F1 {performance.metrics['f1']:.3f}")

dataset = {name: np.concatenate([episode[name] for episode in episodes]) for name in ARRAYS}
dataset["episode"] = np.repeat(range(len(songs)), [episode.num_steps for episode in episodes])
with open(path, "wb") as file:  # under this very name; NumPy would add .npz to others
    np.savez_compressed(file, songs=songs, **dataset)
for name, values in np.load(path).items():
    print(f"{name:15} {values.dtype!s:8} {values.shape}")
