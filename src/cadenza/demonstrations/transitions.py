"""Recorded episodes as the Gymnasium environments would have given them, for other libraries."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cadenza.demonstrations.dataset import LOOKAHEAD, Dataset, Floats
from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY
from cadenza.scene.scene import Scene


class Transitions(NamedTuple):
    """T steps of an episode."""

    goal: Floats
    """(T + 1, (L + 1) * (K + 1)) keys and pedal of the next step and of the L after it, 0 or 1."""
    fingering: Floats
    """(T + 1, F) 1 for each finger that has a key to press next."""
    key_state: Floats
    """(T + 1, K) 0 (up) to 1 (down)."""
    pedal: Floats
    """(T + 1, 1)"""
    joints: Floats
    """(T + 1, J) [m, rad]"""
    velocities: Floats
    """(T + 1, J) [m/s, rad/s]; not part of the environments' observation."""
    chosen: Floats
    """(T, A + 1) actions in [-1, 1] that the demonstrator chose, without noise."""
    played: Floats
    """(T + 1, A + 1) and those that were played, before each state; 0 before the first."""
    reward: Floats
    """(T,)"""

    @property
    def observation(self) -> Floats:
        """(T + 1, D) laid out as in `PianoTask.observation`."""
        return np.concatenate([*self[: Transitions._fields.index("velocities")]], axis=1)

    @property
    def environment(self) -> Floats:
        """(T + 1, D - J) what of it is not of the hands."""
        return np.concatenate([*self[: Transitions._fields.index("joints")]], axis=1)


def transitions(dataset: Dataset, number: int) -> Transitions:
    """Those of the episode of that number.

    Raises:
        CadenzaError: a file is not there, or is damaged.
    """
    scene, steps = dataset.scene, dataset.episodes[number].steps
    count = len(steps) - 1
    batch = dataset.batch(dataset.first[number] + np.arange(count), LOOKAHEAD)
    # After the last step, environments go on showing its goals.
    here = np.minimum(np.arange(count + 1), count - 1)
    depth = np.clip(steps["key_qpos"].astype(np.float32) / scene.keyboard.travel, 0, 1)
    played = unscaled(steps["previous_action"], scene)
    played[0] = 0
    return Transitions(
        goal=batch.goal[here].reshape(count + 1, -1).astype(np.float32),
        fingering=batch.fingering[here, 0].astype(np.float32),
        key_state=depth.astype(np.float32),
        pedal=steps["previous_action"][:, -1:],
        joints=steps["hand_qpos"],
        velocities=steps["hand_qvel"],
        chosen=unscaled(steps["action"][:-1], scene),
        played=played,
        reward=steps["previous_reward"][1:],
    )


def unscaled(actions: Floats, scene: Scene) -> Floats:
    """(..., A + 1) from actuator units to [-1, 1]."""
    low, high = scene.action_low, scene.action_high
    scaled = (actions - (low + high) / 2) / ((high - low) / 2)
    return np.clip(scaled, -1, 1).astype(np.float32)


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yields a folder that becomes `path` when the block ends without an error.

    Raises:
        CadenzaError: there is something at `path`, other than an empty folder.
    """
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise CadenzaError(f"{path}: exists already; choose another folder with --output")
    temporary = path.parent / f"{TEMPORARY}{secrets.token_hex(8)}"
    temporary.mkdir(parents=True)
    try:
        yield temporary
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
