"""Stream of states: sends what is to be played and then each step, while it is played."""

from __future__ import annotations

from collections import deque

import numpy as np

from cadenza.music.performance import STRIKE_TIME, strike_velocity
from cadenza.report.recording import packed
from cadenza.scene.drawing import drawing
from cadenza.studio.messages import ROWS, Message, Send, json_message, row_bytes
from cadenza.studio.synthesizer import INSTRUMENT
from cadenza.tasks import reward
from cadenza.tasks.augmentation import draws_variation
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.piano_task import PianoTask

_ALL_THE_WAY = 255  # of a key that is down, in a row


class StateStream:
    """Sends messages as `cadenza.studio.messages` describes them.

    Attributes:
        header: what is to be played, as JSON.
        rows: the states of all steps so far.
    """

    def __init__(self, task: PianoTask, send: Send) -> None:
        self._task, self._send = task, send
        self._dt, keyboard = task.config.control_timestep, task.scene.keyboard
        self._lowest, self._travel = keyboard.lowest_pitch, keyboard.travel
        before = max(1, round(STRIKE_TIME / self._dt)) + 1
        still = np.zeros(keyboard.num_keys)
        self._depths = deque([still] * before, before)
        self._sounded = still.astype(bool)
        self.header, self.rows = b"", bytearray()

    def begin(self) -> None:
        """Sends what is to be played; music that is drawn at random is sent with the first step."""
        if not draws_variation(self._task.config):
            self._send_header(self._task.tracks[0])

    def _send_header(self, track: GoalTrack) -> None:
        scene, goals = self._task.scene, track.goals
        joints = len(scene.hand_start)
        message = json_message(
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
        self.header = message.content
        self._send(message)

    def step(self) -> None:
        """Sends the state after the step that was just taken."""
        task, state = self._task, self._task.state
        if not self.header:
            self._send_header(task.goals.tracks[0])
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
                (depth * _ALL_THE_WAY).astype(np.uint8).tobytes(),
                sounds.tobytes(),
                bytes([bool(task.pedal_down[0])]),
            )
        )
        row = row.ljust(row_bytes(state.hand_qpos.shape[1], len(depth)), b"\0")
        self.rows += row
        self._send(Message(ROWS, row))
