"""Practice with a robot whose parameters nobody knows, by what is measured and heard of it.

What a planner plays on the nominal robot is played without feedback, and corrected from play to
play by iterative learning control: of joints, so that they move as on the nominal robot, and of
notes, so that they sound as they are written. A song is played ten times, of which the first two
are the generalist's if it knows such hands, and once more as it was heard best.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.robot.closed_loop import ClosedLoop
from cadenza.agents.robot.corrections import NoteCorrections, PressCorrections
from cadenza.agents.robot.protocol import (
    Act,
    Play,
    Robot,
    in_turn,
    notes_heard,
    play,
    scores_heard,
)
from cadenza.agents.robot.servo_response import Response, ServoResponse, identified, usual_response
from cadenza.episode import Episode
from cadenza.music.score import Note
from cadenza.scene.randomization import sliding
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.unknown_robot import PLAYS
from cadenza.tasks.view import View

_GAIN = 0.8  # share of the errors of joints that is corrected
# Of squared changes of controls beside squared errors of joints, times the number of plays: the
# later, the more of what is measured is noise, of which slides have little.
_COST, _COST_OF_SLIDES = 0.1, 0.003
_COST_OF_PLAN = 0.2  # the same before the first play
_WORSE = 0.15  # below the best score, from which on it is hardly chance, and practice goes back
_CLOSED_LOOP = 2  # plays, after which little more is found of the servos
_LESS = 0.5  # share of corrections after a play that was worse


class _Learnt(NamedTuple):
    """What was learnt before a play."""

    corrections: PressCorrections
    controls: Array
    """(T, A) differences from where servos are at the beginning [m, rad]."""


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
        response: how servos respond, as far as it is known.
        sensors_late: for how long what is measured is on its way [s].
    """

    def __init__(
        self, plan: SongPlan, nominal: Episode, known: DomainRandomization, response: Response
    ) -> None:
        """Take what was played on the nominal robot, by a plan, and how robots are drawn.

        Of this it takes how far keyboard and hands may be off, and how late sensors are; `response`
        is what is known of the servos.
        """
        self._track, scene = plan.track, plan.scene
        self._dt, self._servos = self._track.config.control_timestep, servos_of(scene)
        joints = np.concatenate([nominal["hand_qpos0"][None], nominal["hand_qpos"]])
        self._postures, self._played = joints @ self._servos.of_joints, nominal["action"]
        place = known.keyboard_offset + known.mount_offset
        self._notes = NoteCorrections(plan, self._postures, place)
        planned = self._played[:, :-1] - self._postures[0]
        same = np.ones(planned.shape[1])
        self._nominal = self._responding(Response(0.0, same, np.inf * same))
        self._moved = self._nominal.to(planned)
        slides = sliding(scene) @ self._servos.of_joints > 0
        self._cost = np.where(slides, _COST_OF_SLIDES, _COST)
        self.response = response
        self.sensors_late = sum(known.observation_latency) / 2
        self._robot = self._responding(self.response)
        before = self._robot.limited(planned)
        change = self._moved - self._robot.to(before)
        controls = self._robot.controls(before, change, _COST_OF_PLAN * same)
        self._learnt, self._share = _Learnt(self._notes.none(), controls), 1.0
        self.best: Take | None = None
        self._plays = 0
        self._usual = usual_response(self._servos, self._dt, known).fastest
        self._tracked = list[tuple[Array, Array]]()

    def _responding(self, known: Response) -> ServoResponse:
        return ServoResponse(self._servos, self._dt, known)

    def actions(self) -> Array:
        """(T, A) the actions of the next play."""
        controls = self._servos.clip(self._postures[0] + self._learnt.controls)
        return np.column_stack([controls, self._played[:, -1]])

    def learn(self, play: Play) -> Take:
        """Learn from a play of `actions`, and return how it was."""
        seconds, late = len(play.actions) * self._dt, self.sensors_late
        notes = notes_heard(play.heard, seconds, late)
        measured = play.joints @ self._servos.of_joints
        # The hands begin where they are put, so that sensors show there by how much they are off.
        measured += self._postures[0] - measured[0]
        f1, onsets = scores_heard(self._track, notes)
        take = Take(play.actions, f1, onsets, notes, measured, self._learnt)
        self._plays += 1
        self._notes.locate(notes, measured)
        self._identify(take)
        if self.best is None or take.score >= self.best.score:
            self.best, self._share = take, 1.0
        learn_from = take
        if take.score < self.best.score - _WORSE:
            learn_from, self._share = self.best, self._share * _LESS
        self._learnt = self._corrected(learn_from)
        return take

    def _identify(self, take: Take) -> None:
        """Find how servos respond, by which response joints have moved so late and so slowly."""
        sent = take.actions[:, :-1] - self._postures[0]
        self._tracked.append((sent, take.measured[1:] - self._postures[1:] + self._moved))
        late = self.response.late + self.sensors_late if self.best else None
        found = identified(self._servos, self._dt, self._tracked, self._usual, late)
        self.sensors_late = min(self.sensors_late, found.late)
        self.response = found._replace(late=found.late - self.sensors_late)
        self._robot = self._responding(self.response)

    def _wanted(self, corrections: PressCorrections) -> Array:
        """(T, A) the postures after each step of a play with its corrections."""
        strikes = self._nominal.to(self._notes.strikes(corrections))
        return self._notes.postures(corrections)[1:] + strikes

    def _corrected(self, take: Take) -> _Learnt:
        """What is learnt from a play, and from what was learnt before it."""
        before = take.learnt.corrections
        corrections = self._notes.corrected(before, take.notes, take.measured, self._share)
        wanted, measured = self._wanted(before), take.measured
        late = self.sensors_late / self._dt  # sensors show what was then
        after = np.concatenate([measured[2:], measured[-1:]])
        error = wanted - (1 - late) * measured[1:] - late * after
        change = self._share * _GAIN * error + self._wanted(corrections) - wanted
        sent = take.actions[:, :-1] - self._postures[0]
        return _Learnt(corrections, self._robot.controls(sent, change, self._cost * self._plays))


class ScoredPlay(NamedTuple):
    """A play, and how it was heard."""

    actions: Array
    """(T, A) in actuator units, the pedal last."""
    f1: float
    note_onset_f1: float


def learn_in_ten_plays(
    robot: Robot, view: View, plan: SongPlan, nominal: Episode, known: DomainRandomization
) -> Iterator[ScoredPlay]:
    """Play a song ten times on a robot, and once more as it was heard best.

    The first plays are the generalist's in closed loop, if it knows such hands. The others practise
    what the planner played on the nominal robot.

    Args:
        robot: the driver of the robot.
        view: a view before the first step on the nominal robot.
        plan: the planner's plan.
        nominal: what it played on the nominal robot.
        known: how robots are drawn.
    """
    track, num_steps = plan.track, int(view.num_steps[0])
    dt = track.config.control_timestep
    response = usual_response(servos_of(plan.scene), dt, known)
    done = list[tuple[float, Callable[[], Act]]]()
    if ClosedLoop.knows(view):
        closed = ClosedLoop(view, known)
        for _ in range(_CLOSED_LOOP):
            how: Callable[[], Act] = partial(closed.acting, closed.response)
            played = play(robot, num_steps, how())
            take = ScoredPlay(played.actions, *closed.learn(played))
            done.append((take.f1 + take.note_onset_f1, how))
            yield take
        response = closed.response
    practice = RobotPractice(plan, nominal, known, response)
    while len(done) < PLAYS:
        how = partial(in_turn, practice.actions())
        heard = practice.learn(play(robot, num_steps, how()))
        done.append((heard.score, how))
        yield ScoredPlay(heard.actions, heard.f1, heard.note_onset_f1)
    _, best = max(done, key=lambda each: each[0])
    played = play(robot, num_steps, best())
    notes = notes_heard(played.heard, num_steps * dt, practice.sensors_late)
    yield ScoredPlay(played.actions, *scores_heard(track, notes))
