"""The plan that a residual policy corrects: inverse kinematics of the song, with feedback."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from cadenza.agents.planning.nominal import nominal_plan
from cadenza.agents.rl.observation import Floats
from cadenza.errors import CadenzaError
from cadenza.model.servos import servos_of
from cadenza.music.fingering import find_fingering
from cadenza.music.score import UNKNOWN_FINGER, Score
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.music import goals_of
from cadenza.tasks.piano_task import PianoTask

Array = NDArray[np.float64]

# How far a correction may go, about three times what the planner's own search draws [m, rad].
_REACH = {"forearm_tx": 0.03, "forearm_ty": 0.015, "WRJ2": 0.1, "WRJ1": 0.1}
_FINGER_REACH = 0.25


def without_fingers(score: Score) -> Score:
    """The score for which fingers that suit these hands are to be found."""
    notes = (replace(note, finger=UNKNOWN_FINGER) for note in score.notes)
    return replace(score, notes=tuple(notes))


class PlanFollower:
    """Turns corrections in [-1, 1] into actions, of a plan for the only score of a task."""

    def __init__(self, task: PianoTask, score: Score) -> None:
        """`score` has the fingers that are to play it; where it names none they are found.

        Raises:
            CadenzaError: the task changes the score or the start at random, or has no hands.
        """
        check_one_score(task.config)
        if not task.scene.sides:
            raise CadenzaError("a residual policy corrects a plan for hands, and here are none")
        if not score.has_fingering:  # the task does not reward fingers
            sides = task.scene.sides
            score, _ = find_fingering(score, "both" if len(sides) == 2 else sides[0])
        goals = goals_of(score, task.config)
        dt = task.config.control_timestep
        start = np.zeros(len(task.scene.hand_joint_names))
        with threadpool_limits(1):  # see ScorePlanner
            nominal = nominal_plan(task.scene, goals.keys, goals.fingers, start, dt)
        self._tracking = nominal.tracking
        servos = servos_of(task.scene)
        self._to_posture = np.linalg.pinv(servos.joints)
        self._reach = np.array([_REACH.get(name, _FINGER_REACH) for name in servos.names])
        self._pedal = goals.sustain.astype(np.float64)
        self._low, self._high = task.action_low, task.action_high

    @property
    def actions(self) -> Floats:
        """(T, A) of the plan, in [-1, 1]."""
        action = np.concatenate([self._tracking.ctrl, self._pedal[:, None]], axis=1)
        centre, scale = (self._high + self._low) / 2, (self._high - self._low) / 2
        return ((action - centre) / scale).astype(np.float32)

    def ctrl(self, task: PianoTask, correction: Floats) -> Array:
        """(N, A) actions in actuator units from corrections (N, A) in [-1, 1].

        The pedal is the score's whatever the correction.
        """
        row, state, tracking = task.sheets.row, task.state, self._tracking
        position, speed = state.hand_qpos @ self._to_posture, state.hand_qvel @ self._to_posture
        here = np.stack([position, speed], axis=-1)
        feedback = (tracking.gain[row] * (here - tracking.expected[row])).sum(axis=-1)
        hands = tracking.ctrl[row] - feedback + self._reach * correction[:, :-1]
        both = np.concatenate([hands, self._pedal[row, None]], axis=1)
        return np.clip(both, self._low, self._high)


def check_one_score(config: TaskConfig) -> None:
    """Raises: CadenzaError: the task changes the score or the start at random."""
    names = ("random_hand_position", "random_stretch", "random_pitch_shift", "random_octave_shift")
    if drawn := [name for name in names if getattr(config, name)]:
        raise CadenzaError(
            f"a residual policy corrects one plan of one score: leave out {', '.join(drawn)}"
        )
