"""A robot as whoever practises with it sees it: five functions, and no parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from cadenza.agents.agent import Array
from cadenza.music.metrics import playing_metrics
from cadenza.music.performance import KeyEvent, SoundedNotes
from cadenza.music.score import Note, Score
from cadenza.tasks.goal_track import GoalTrack


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


Act = Callable[[int, Array], Array]
"""Gives the action (A,) of a control step, by its number and the joints (J,) that were measured."""


def play(robot: Robot, num_steps: int, act: Act) -> Play:
    """Play as many control steps."""
    robot.start()
    try:
        joints, actions, heard = [robot.read()], list[Array](), list[Heard]()
        for step in range(num_steps):
            actions.append(act(step, joints[-1]))
            robot.send(actions[-1])
            joints.append(robot.read())
            heard += robot.heard()
    finally:
        robot.stop()
    return Play(np.array(actions), np.array(joints), tuple(heard))


def in_turn(actions: Array) -> Act:
    """Give actions (T, A) one after the other, whatever is measured."""
    return lambda step, _: np.asarray(actions[step])


def scores_heard(track: GoalTrack, notes: Sequence[Note]) -> tuple[float, float]:
    """F1 and note onset F1 of a track, whose pedal is as written, by the notes that were heard."""
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


def notes_heard(heard: Iterable[Heard], seconds: float, late: float = 0.0) -> list[Note]:
    """The notes of the first `seconds`, by the time, of messages that are so `late` [s]."""
    sounded, none = SoundedNotes(0.0), float("nan")
    for time, pitch, velocity in heard:
        times = (time - late, none) if velocity else (none, time - late)
        sounded.add(KeyEvent(0, pitch, *times, velocity))
    return list(sounded.notes(seconds, lowest_pitch=0))
