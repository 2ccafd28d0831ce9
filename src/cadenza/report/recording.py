"""A performance as the text that a page holds; `recording.js` reads it.

Arrays over time stand there as differences from step to step, deflated. Of the hands there are
only the joints' positions: the page's scene puts the bodies where they belong.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.episode import Episode
from cadenza.report.sound import Samples, encode_mp3

_UNIT = 5e-5  # [m, rad] of a joint's position; a fingertip is then less than 0.1 mm off
_PIECE = 3 << 18  # bytes that are written at once; base64 wants a multiple of 3


def embedded(
    episode: Episode,
    audio: Samples,
    sample_rate: int,
    goal_mp3: bytes = b"",
) -> Iterator[str]:
    """The elements of a page that hold a performance and its sound, in pieces.

    `goal_mp3` is what it should have sounded like, for pages on which one can compare.
    """
    yield '<script type="application/json" class="recording">'
    yield in_json(_recording(episode))
    yield "</script>"
    # At least as long as the episode: the page's clock is this sound.
    sound = encode_mp3(audio, sample_rate, seconds=episode.num_steps * episode.dt)
    for kind, mp3 in (("sound", sound), ("goal", goal_mp3)):
        if not mp3:
            continue
        yield f'<script type="text/plain" class="{kind}">'
        for start in range(0, len(mp3), _PIECE):
            yield base64.b64encode(mp3[start : start + _PIECE]).decode()
        yield "</script>"


def _recording(episode: Episode) -> dict[str, Any]:
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
"""Of a key that is not rightly silent; `verdict` counts them from 1."""


def verdict(goal: NDArray[np.bool_], played: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """What became of each, of any shape: 0 rightly silent, 1 hit, 2 wrong, 3 missed."""
    return np.select([goal & played, played, goal], [1, 2, 3], 0).astype(np.uint8)


def packed(values: NDArray[Any]) -> str:
    """`values` (T, ...) as base64 of deflated differences from step to step.

    They are those of the bit patterns, modulo 2^bits: nothing is rounded. A column follows the
    other, first all lowest bytes, then all of the next.
    """
    size = values.dtype.itemsize
    patterns = np.ascontiguousarray(values).view(f"u{size}").reshape(len(values), -1)
    steps = np.diff(patterns, axis=0, prepend=np.zeros_like(patterns[:1]))
    planes = steps.T.astype(f"<u{size}", order="C").view(np.uint8).reshape(-1, size).T
    return base64.b64encode(zlib.compress(planes.tobytes())).decode()


def in_json(content: Any) -> str:
    """JSON that cannot end the script element it stands in."""
    return json.dumps(content, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
