"""A performance told step by step, while it is made, as `cadenza.studio.messages` has it."""

from __future__ import annotations

import json
import struct
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cadenza.music.performance import STRIKE_TIME, strike_velocity
from cadenza.report.recording import packed
from cadenza.report.sound import DAMPING, LAST_DAMPER, LOUDER, tone
from cadenza.scene.drawing import drawing
from cadenza.studio.messages import JSON, ROWS, TONE, Message, row_bytes
from cadenza.tasks import reward
from cadenza.tasks.piano_task import PianoTask

_RATE = 32_000  # [Hz]
_SECONDS = {60: 5.0, 84: 3.5, 128: 2.0}  # [s] that tones last below a pitch: high ones die sooner
_FADE = 0.5  # [s] at its end
_BAND = 32  # velocities that share a tone

Send = Callable[[Message], None]


def as_json(**content: Any) -> Message:
    """A message that JSON can say."""
    return Message(JSON, json.dumps(content, allow_nan=False).encode())


class Live:
    """Sends what is to be played, then each step, and each tone before the key that needs it."""

    def __init__(self, task: PianoTask, send: Send) -> None:
        self._task, self._send = task, send
        self._dt, keyboard = task.config.control_timestep, task.scene.keyboard
        self._lowest, self._travel = keyboard.lowest_pitch, keyboard.travel
        before = max(1, round(STRIKE_TIME / self._dt)) + 1
        still = np.zeros(keyboard.num_keys)
        self._depths = deque([still] * before, before)
        self._sounded = still.astype(bool)
        self._tones: set[tuple[int, int]] = set()

    def begin(self) -> None:
        """Tells what is to be played by whom; all of a piece but how it goes."""
        scene, goals = self._task.scene, self._task.tracks[0].goals
        joints = len(scene.hand_start)
        self._send(
            as_json(
                dt=self._dt,
                steps=goals.num_steps,
                keys=scene.keyboard.num_keys,
                lowest=self._lowest,
                joints=joints,
                row=row_bytes(joints, scene.keyboard.num_keys),
                start=[round(float(x), 6) for x in scene.hand_start],
                scene=drawing(scene),
                goal=packed(goals.keys.astype(np.uint8)),
                pedal=packed(goals.sustain.astype(np.uint8)),
                sound={
                    "rate": _RATE,
                    "band": _BAND,
                    "damping": DAMPING,
                    "last_damper": LAST_DAMPER,
                    "louder": LOUDER,
                },
            )
        )

    def step(self) -> None:
        """Tells what the step that was just taken has come to."""
        task, state = self._task, self._task.state
        depth = reward.key_state(state.key_qpos[0], self._travel)
        self._depths.append(depth)
        sounding = task.sounding[0]
        sounds = sounding.astype(np.uint8)
        struck = np.flatnonzero(sounding & ~self._sounded)
        velocity = strike_velocity(np.array(self._depths)[:, struck].T)
        sounds[struck] = velocity
        self._sounded = sounding.copy()
        for key, hard in zip(struck.tolist(), velocity.tolist(), strict=True):
            self._tone(key + self._lowest, hard // _BAND)
        row = b"".join(
            (
                state.hand_qpos[0].astype("<f4").tobytes(),
                (depth * 255).astype(np.uint8).tobytes(),
                sounds.tobytes(),
                bytes([bool(task.pedal_down[0])]),
            )
        )
        self._send(Message(ROWS, row.ljust(row_bytes(state.hand_qpos.shape[1], len(depth)), b"\0")))

    def _tone(self, pitch: int, band: int) -> None:
        """Sends it unless it has been sent."""
        if (pitch, band) in self._tones:
            return
        self._tones.add((pitch, band))
        seconds = next(seconds for above, seconds in _SECONDS.items() if pitch < above)
        samples = tone(pitch, (band + 0.5) * _BAND / 127, seconds, _RATE)
        self._send(Message(TONE, struct.pack("<BBxx", pitch, band) + _encoded(samples)))


def _encoded(samples: NDArray[np.float32]) -> bytes:
    """Peak and samples (n,), faded at their end."""
    fade = int(_FADE * _RATE)
    samples = samples.copy()
    samples[-fade:] *= np.linspace(1, 0, fade, dtype=np.float32)
    peak = float(np.abs(samples).max())
    return struct.pack("<f", peak) + np.rint(samples / peak * 32767).astype("<i2").tobytes()
