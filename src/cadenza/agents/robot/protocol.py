"""A robot as whoever practises with it sees it: five functions, and no parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple, Protocol

import numpy as np

from cadenza.agents.agent import Array
from cadenza.music.performance import KeyEvent, SoundedNotes
from cadenza.music.score import Note


class Heard(NamedTuple):
    """A MIDI message of the instrument: a key began to sound, or ceased to."""

    time: float
    """When it came, since the beginning of the play [s]."""
    pitch: int
    """MIDI number of the key."""
    velocity: float
    """How loud, 1 to 127; 0 for a key that has ceased to sound."""


class Robot(Protocol):
    """Hands at an instrument. Drivers have these five methods, whatever they drive.

    A play is `start`, `read`, then for each control step `send`, `read` and `heard`, then `stop`.
    """

    def start(self) -> None:
        """Bring the hands to where songs begin, at rest, and let the time of the play begin."""

    def send(self, action: Array) -> None:
        """Send where servos are to be from now on (A,) [m, rad], the pedal last, 0 to 1."""

    def read(self) -> Array:
        """Joints (J,) as measured when the control step ends, for which it waits [m, rad]."""

    def heard(self) -> list[Heard]:
        """Return what the instrument has sent since the last call, in the order of time."""

    def stop(self) -> None:
        """End the play, whatever has happened: the hands may go limp."""


class Play(NamedTuple):
    """What was sent to a robot in one play of T steps, measured and heard."""

    actions: Array
    """(T, A) actions in actuator units, the pedal last."""
    joints: Array
    """(T + 1, J) measured joints before the first step and after each [m, rad]."""
    heard: tuple[Heard, ...]


def play(robot: Robot, actions: Array) -> Play:
    """Play actions (T, A), one in each control step."""
    robot.start()
    try:
        joints, heard = [robot.read()], list[Heard]()
        for action in actions:
            robot.send(action)
            joints.append(robot.read())
            heard += robot.heard()
    finally:
        robot.stop()
    return Play(actions, np.array(joints), tuple(heard))


def notes_heard(heard: Iterable[Heard], seconds: float, late: float = 0.0) -> list[Note]:
    """The notes of the first `seconds`, by the time, of messages that are so `late` [s]."""
    sounded, none = SoundedNotes(0.0), float("nan")
    for time, pitch, velocity in heard:
        times = (time - late, none) if velocity else (none, time - late)
        sounded.add(KeyEvent(0, pitch, *times, velocity))
    return list(sounded.notes(seconds, lowest_pitch=0))
