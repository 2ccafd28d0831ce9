"""A performance told step by step, while it is made, as `cadenza.studio.messages` has it."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from cadenza.music.performance import STRIKE_TIME, strike_velocity
from cadenza.report.recording import packed
from cadenza.scene.drawing import drawing
from cadenza.studio.messages import JSON, ROWS, Message, row_bytes
from cadenza.studio.tones import INSTRUMENT
from cadenza.tasks import reward
from cadenza.tasks.augmentation import draws_variation
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.piano_task import PianoTask

Send = Callable[[Message], None]


def as_json(**content: Any) -> Message:
    """A message that JSON can say."""
    return Message(JSON, json.dumps(content, allow_nan=False).encode())


class Live:
    """Sends what is to be played, then each step.

    Attributes:
        about: what is to be played, as JSON.
        rows: those of all steps so far.
    """

    def __init__(self, task: PianoTask, send: Send) -> None:
        self._task, self._send = task, send
        self._dt, keyboard = task.config.control_timestep, task.scene.keyboard
        self._lowest, self._travel = keyboard.lowest_pitch, keyboard.travel
        before = max(1, round(STRIKE_TIME / self._dt)) + 1
        still = np.zeros(keyboard.num_keys)
        self._depths = deque([still] * before, before)
        self._sounded = still.astype(bool)
        self.about, self.rows = b"", bytearray()

    def begin(self) -> None:
        """Tells what is to be played by whom; of what is drawn, the first step tells."""
        if not draws_variation(self._task.config):
            self._begin(self._task.tracks[0])

    def _begin(self, track: GoalTrack) -> None:
        """All of a piece but how it goes."""
        scene, goals = self._task.scene, track.goals
        joints = len(scene.hand_start)
        message = as_json(
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
            notes=sorted((n.pitch - self._lowest, n.start) for n in track.delayed_score.notes),
            sound=INSTRUMENT,
        )
        self.about = message.content
        self._send(message)

    def step(self) -> None:
        """Tells what the step that was just taken has come to."""
        task, state = self._task, self._task.state
        if not self.about:
            self._begin(task.goals.tracks[0])
        depth = reward.key_state(state.key_qpos[0], self._travel)
        self._depths.append(depth)
        sounding = task.sounding[0]
        sounds = sounding.astype(np.uint8)
        struck = np.flatnonzero(sounding & ~self._sounded)
        sounds[struck] = strike_velocity(np.array(self._depths)[:, struck].T)
        self._sounded = sounding.copy()
        row = b"".join(
            (
                state.hand_qpos[0].astype("<f4").tobytes(),
                (depth * 255).astype(np.uint8).tobytes(),
                sounds.tobytes(),
                bytes([bool(task.pedal_down[0])]),
            )
        )
        row = row.ljust(row_bytes(state.hand_qpos.shape[1], len(depth)), b"\0")
        self.rows += row
        self._send(Message(ROWS, row))
