"""Practice with a robot whose parameters nobody knows, by what is measured and heard of it.

What a planner plays on the nominal robot is played without feedback, and corrected from play to
play by iterative learning control: of joints, so that they move as on the nominal robot, and of
notes, so that they sound as they are written.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.robot.corrections import NoteCorrections, PressCorrections
from cadenza.agents.robot.protocol import Play, notes_heard
from cadenza.agents.robot.servo_response import ServoResponse
from cadenza.episode import Episode
from cadenza.music.metrics import playing_metrics
from cadenza.music.score import Note, Score
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import DomainRandomization

_DELAYS = np.arange(0.0, 0.15, 0.005)  # [s] among which that of actions and observations is found
_GAIN = 0.7  # share of the errors of joints that is corrected
_COST = 0.6  # of squared corrections beside squared errors of joints
_COST_OF_PLAN = 0.2  # the same of what is known beforehand
_WORSE = 0.02  # below the best score, from which on practice goes back to it
_LESS = 0.5  # share of corrections after a play that was worse


class Delays(NamedTuple):
    """For how long actions are on their way to a robot, and what it measures back [s]."""

    actions: float
    observations: float


class _Learnt(NamedTuple):
    """What was learnt before a play."""

    corrections: PressCorrections
    joints: Array
    """(T, A) corrections of controls by what joints did."""


class Take(NamedTuple):
    """A play, how it was scored by what was heard, and what it was played with."""

    actions: Array
    """(T, A) in actuator units, the pedal last."""
    f1: float
    note_onset_f1: float
    notes: list[Note]
    """The notes that were heard, by the time of the song."""
    measured: Array
    """(T + 1, A) postures by the sensors, without what they were off at the beginning."""
    learnt: _Learnt

    @property
    def score(self) -> float:
        """F1 and note onset F1."""
        return self.f1 + self.note_onset_f1


class RobotPractice:
    """Practice of one song with one robot.

    Attributes:
        best: the best play so far, by what was heard; None before the first.
    """

    def __init__(self, plan: SongPlan, nominal: Episode, known: DomainRandomization) -> None:
        """Take what was played on the nominal robot, by a plan, and how robots are drawn.

        Of this it takes the middle of the delays, and how far keyboard and hands may be off.
        """
        self._track, scene = plan.track, plan.scene
        self._dt, self._servos = self._track.config.control_timestep, servos_of(scene)
        joints = np.concatenate([nominal["hand_qpos0"][None], nominal["hand_qpos"]])
        self._postures, self._played = joints @ self._servos.of_joints, nominal["action"]
        self._controls = self._played[:, :-1] - self._postures[0]
        self._notes = NoteCorrections(
            plan, self._postures, known.keyboard_offset + known.mount_offset
        )
        self._nominal = self._response(0.0)
        late = (known.latency, known.observation_latency)
        self._delays, self._found = Delays(*(sum(each) / 2 for each in late)), False
        self._actions = self._response(self._delays.actions)
        self._sensed = self._response(sum(self._delays))
        self._learnt = _Learnt(self._notes.none(), np.zeros_like(self._controls))
        self._share = 1.0
        self.best: Take | None = None

    @property
    def delays(self) -> Delays:
        """The delays as far as they are known."""
        return self._delays

    def _response(self, late: float) -> ServoResponse:
        return ServoResponse(self._servos, self._dt, late)

    def actions(self) -> Array:
        """(T, A) the actions of the next play."""
        corrections, joints = self._learnt
        controls = self._controls + self._notes.strikes(corrections)
        wanted = self._nominal.to(controls) - self._actions.to(self._controls)
        wanted += (self._notes.postures(corrections) - self._postures)[1:]
        controls = self._actions.inverse(wanted, _COST_OF_PLAN) + joints + self._played[:, :-1]
        return np.column_stack([self._servos.clip(controls), self._played[:, -1]])

    def learn(self, play: Play) -> Take:
        """Learn from a play of `actions`, and return how it was."""
        seconds, late = len(play.actions) * self._dt, self._delays.observations
        notes = notes_heard(play.heard, seconds, late)
        measured = play.joints @ self._servos.of_joints
        # The hands begin where they are put, so that sensors show there by how much they are off.
        measured += self._postures[0] - measured[0]
        f1, onsets = self._scores(notes)
        take = Take(play.actions, f1, onsets, notes, measured, self._learnt)
        if not self._found:
            self._find_delays(take)
        if self.best is None or take.score >= self.best.score:
            self.best, self._share = take, 1.0
        learn_from = take
        if take.score < self.best.score - _WORSE:
            learn_from, self._share = self.best, self._share * _LESS
        self._learnt = self._corrected(learn_from)
        return take

    def _scores(self, notes: list[Note]) -> tuple[float, float]:
        """F1 and note onset F1 of what was heard."""
        goals, lowest = self._track.goals, self._track.scene.keyboard.lowest_pitch
        ends = self._dt * (1 + np.arange(goals.num_steps))
        sounding = np.zeros_like(goals.keys)
        for note in notes:
            sounding[:, note.pitch - lowest] |= (note.start <= ends) & (ends < note.end)
        pedal = goals.sustain
        metrics = playing_metrics(
            *(sounding, pedal, goals.keys, pedal, self._dt, self._track.delayed_score, lowest),
            played=Score(tuple(notes)),
        )
        return metrics["f1"], metrics["note_onset_f1"]

    def _find_delays(self, take: Take) -> None:
        """Find the delay of actions and observations together with which joints moved so late."""
        sent = take.actions[:, :-1] - self._postures[0]
        nominal = self._postures[1:] - self._nominal.to(self._controls)
        errors = [
            np.square(take.measured[1:] - nominal - self._response(late).to(sent)).mean()
            for late in _DELAYS
        ]
        both = float(_DELAYS[np.argmin(errors)])
        late = self._delays.observations
        self._delays, self._found = Delays(max(both - late, 0.0), min(late, both)), True
        self._actions = self._response(self._delays.actions)
        self._sensed = self._response(both)

    def _corrected(self, take: Take) -> _Learnt:
        """What is learnt from a play, and from what was learnt before it."""
        corrections, joints = take.learnt
        strikes = self._nominal.to(self._notes.strikes(corrections))
        wanted = self._notes.postures(corrections)
        wanted[1:] += strikes
        back = self._delays.observations / self._dt  # sensors show what was then
        wanted[1:] = (1 - back) * wanted[1:] + back * wanted[:-1]
        error = (wanted - take.measured)[1:]
        joints = joints + self._share * _GAIN * self._sensed.inverse(error, _COST)
        return _Learnt(
            self._notes.corrected(corrections, take.notes, take.measured, self._share), joints
        )
