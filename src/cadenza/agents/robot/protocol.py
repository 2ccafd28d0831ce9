"""A robot as practice sees it: five methods, and no parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from cadenza.agents.agent import Array
from cadenza.errors import CadenzaError, quoted
from cadenza.music.metrics import playing_metrics
from cadenza.music.performance import KeyEvent, SoundedNotes
from cadenza.music.score import LOUDEST, MIDI_PITCHES, Note, Score
from cadenza.tasks.goal_track import GoalTrack


class KeyMessage(NamedTuple):
    """A MIDI message of the instrument: the onset or the offset of a key."""

    time: float
    """The time since the beginning of the play [s]."""
    pitch: int
    """MIDI number of the key."""
    velocity: float
    """MIDI velocity, 1 to 127; 0 for an offset."""


class Robot(Protocol):
    """Hands at an instrument. Every driver has these five methods.

    A play is `start`, `read`, then for each control step `send`, `read` and `messages`, then
    `stop`.
    """

    def start(self) -> None:
        """Bring the hands to the start, at rest, and begin the time of the play."""

    def send(self, action: Array) -> None:
        """Send the setpoints of the servos (A,) [m, rad], the pedal last, 0 to 1."""

    def read(self) -> Array:
        """Wait for the end of the control step, and return the measured joints (J,) [m, rad]."""

    def messages(self) -> list[KeyMessage]:
        """Messages of the instrument since the last call, by time."""

    def stop(self) -> None:
        """End the play, even after an error: the hands may go limp."""


class CheckedRobot:
    """A robot by a driver of others, whose joints and messages are checked.

    Its methods raise CadenzaError for what no robot measures or no instrument says.
    """

    def __init__(self, driver: Robot, name: str, num_joints: int) -> None:
        self._driver, self._name, self._num_joints = driver, name, num_joints
        self.start, self.send, self.stop = driver.start, driver.send, driver.stop

    def read(self) -> Array:
        """See `Robot.read`."""
        joints = np.asarray(self._driver.read(), np.float64)
        if joints.shape != (self._num_joints,) or not np.isfinite(joints).all():
            raise CadenzaError(
                f"robot {self._name}: read() returned numbers of shape {joints.shape}: give "
                f"({self._num_joints},) finite ones, in the order of scene.hand_joint_names"
            )
        return joints

    def messages(self) -> list[KeyMessage]:
        """See `Robot.messages`."""
        return [self._message(each) for each in self._driver.messages()]

    def _message(self, given: Sequence[float]) -> KeyMessage:
        time, pitch, velocity = map(float, given)
        if not (np.isfinite(time) and pitch in MIDI_PITCHES and 0 <= velocity <= LOUDEST):
            raise CadenzaError(
                f"robot {self._name}: messages() returned {quoted(tuple(given))}: give the time "
                f"[s], the MIDI number of the key, and 0 to {LOUDEST}"
            )
        return KeyMessage(time, int(pitch), velocity)


class Play(NamedTuple):
    """The actions of one play of T steps, and the joints and messages of the robot."""

    actions: Array
    """(T, A) actions in actuator units, the pedal last."""
    joints: Array
    """(T + 1, J) measured joints before the first step and after each [m, rad]."""
    messages: tuple[KeyMessage, ...]


Act = Callable[[int, Array], Array]
"""Action (A,) as a function of the number of a control step and the measured joints (J,)."""


def play(robot: Robot, num_steps: int, act: Act) -> Play:
    """Play `num_steps` control steps."""
    robot.start()
    try:
        joints, actions, messages = [robot.read()], list[Array](), list[KeyMessage]()
        for step in range(num_steps):
            actions.append(act(step, joints[-1]))
            robot.send(actions[-1])
            joints.append(robot.read())
            messages += robot.messages()
    finally:
        robot.stop()
    return Play(np.array(actions), np.array(joints), tuple(messages))


def in_turn(actions: Array) -> Act:
    """Actions (T, A) one after the other, without feedback."""
    return lambda step, _: np.asarray(actions[step])


def scores_heard(track: GoalTrack, notes: Sequence[Note]) -> tuple[float, float]:
    """F1 and note onset F1 of a track by the notes heard, with the pedal as written."""
    goals, dt = track.goals, track.config.control_timestep
    lowest = track.scene.keyboard.lowest_pitch
    ends = dt * (1 + np.arange(goals.num_steps))
    sounding = np.zeros_like(goals.keys)
    for note in notes:
        sounding[:, note.pitch - lowest] |= (note.start <= ends) & (ends < note.end)
    pedal = goals.sustain
    metrics = playing_metrics(
        *(sounding, pedal, goals.keys, pedal, dt, track.delayed_score, lowest),
        played=Score(tuple(notes)),
    )
    return metrics["f1"], metrics["note_onset_f1"]


def notes_heard(messages: Iterable[KeyMessage], seconds: float, late: float = 0.0) -> list[Note]:
    """Notes of the first `seconds`, by time, from messages that are `late` [s]."""
    sounded, none = SoundedNotes(0.0), float("nan")
    for time, pitch, velocity in messages:
        times = (time - late, none) if velocity else (none, time - late)
        sounded.add(KeyEvent(0, pitch, *times, velocity))
    return list(sounded.notes(seconds, lowest_pitch=0))
