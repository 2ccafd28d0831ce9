"""The driver of a simulated robot, whose parameters are hidden."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.robot.protocol import KeyMessage
from cadenza.tasks.reward import midi_velocity
from cadenza.tasks.unknown_robot import UnknownRobotEnv


class SimulatedRobot:
    """The driver of `cadenza/UnknownRobot-v0`: play n is the reset with the seed n, from 0 on.

    Attributes:
        env: the environment.
        scored: the metrics of the play that is scored; empty before.
    """

    def __init__(self, env: UnknownRobotEnv) -> None:
        """Take an environment in which nothing has been played."""
        self.env, self._spec = env, env.task.spec
        self._plays, self._steps = 0, 0
        self._messages: list[KeyMessage] = []
        self.scored: Mapping[str, Any] = {}

    def start(self) -> None:
        self.env.reset(seed=self._plays)
        self._plays, self._steps, self._messages = self._plays + 1, 0, []

    def send(self, action: Array) -> None:
        *_, info = self.env.step(self._spec.unscale_action(action))
        metrics = {n.partition("/")[2]: v for n, v in info.items() if n.startswith("metrics/")}
        self.scored = self.scored or metrics
        self._listen()
        self._steps += 1

    def read(self) -> Array:
        return self.env.task.sensed.hand_qpos[0].copy()

    def messages(self) -> list[KeyMessage]:
        messages, self._messages = self._messages, []
        return messages

    def stop(self) -> None:
        """Do nothing: the next play begins with a reset."""

    def _listen(self) -> None:
        onset, offset, speed = (values[0] for values in self.env.task.sensed.key_events)
        keyboard = self._spec.scene.keyboard
        begin = self._steps * self._spec.config.control_timestep
        loudness = np.maximum(midi_velocity(speed, keyboard), 1)
        for times, velocity in (onset, loudness), (offset, np.zeros_like(loudness)):
            for key in np.flatnonzero(np.isfinite(times)):
                time, pitch = begin + times[key], int(key) + keyboard.lowest_pitch
                self._messages.append(KeyMessage(float(time), pitch, float(velocity[key])))
        self._messages.sort()
