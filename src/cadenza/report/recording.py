"""A performance as the data that a page holds; `recording.js` reads it.

Arrays over time are differences from step to step, deflated. Of the hands there are only the
joints' positions: the page's scene puts the bodies where they belong.
"""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.episode import Episode

_UNIT = 5e-5  # [m, rad] of a joint's position; a fingertip is then less than 0.1 mm off


def recording_of(episode: Episode) -> dict[str, Any]:
    """Returns what `recording.js` reads, as JSON has it."""
    scene = episode.scene
    joints = episode["hand_qpos"] if scene.get("skeleton") else np.empty((episode.num_steps, 0))
    depth = episode.key_depth
    depth = np.zeros_like(episode["key_qpos"]) if depth is None else depth
    rewards = {
        name.removeprefix("reward_"): packed(np.asarray(values, np.float32))
        for name, values in episode.arrays.items()
        if name.startswith("reward_")
    }
    return {
        "dt": episode.dt,
        "steps": episode.num_steps,
        "keys": episode["key_qpos"].shape[1],
        "lowest": episode.lowest_pitch,
        "scene": scene,
        "unit": _UNIT,
        "joints": packed(np.round(joints / _UNIT).astype(np.int32)),
        "angles": packed((depth * 255).astype(np.uint8)),
        "states": packed(verdict(episode["goal_keys"], episode["key_activation"])),
        "pedal": packed(verdict(episode["goal_sustain"], episode["sustain_activation"])),
        "rewards": dict(sorted(rewards.items(), key=lambda item: item[0] != "total")),
    }


VERDICTS = ("hit", "wrong", "missed")
"""Names of what `verdict` returns, from 1 on."""


def verdict(goal: NDArray[np.bool_], played: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Returns for each key and step, of any shape: 0 rightly silent, 1 hit, 2 wrong, 3 missed."""
    return np.select([goal & played, played, goal], [1, 2, 3], 0).astype(np.uint8)


def packed(values: NDArray[Any]) -> str:
    """Returns `values` (T, ...) as base64 of deflated differences from step to step.

    The differences are of the bit patterns, modulo 2^bits: nothing is rounded. One column follows
    the other, first all lowest bytes, then all of the next.
    """
    size = values.dtype.itemsize
    patterns = np.ascontiguousarray(values).view(f"u{size}").reshape(len(values), -1)
    steps = np.diff(patterns, axis=0, prepend=np.zeros_like(patterns[:1]))
    planes = steps.T.astype(f"<u{size}", order="C").view(np.uint8).reshape(-1, size).T
    return base64.b64encode(zlib.compress(planes.tobytes())).decode()
