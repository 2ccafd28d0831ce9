"""Practice with a robot of unknown parameters, by measured joints and notes heard.

The planner's performance on the nominal robot is played without feedback, and corrected from play
to play by iterative learning control: of joints, so that they move as on the nominal robot, and of
notes, so that they sound as written. A song is played ten times, the first two times by the
generalist if it knows these hands, and once more as in the best play.
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
from cadenza.agents.robot.protocol import Act, Play, Robot, in_turn, notes_heard, play, scores_heard
from cadenza.agents.robot.servo_response import Response, ServoResponse, identified, usual_response
from cadenza.episode import Episode
from cadenza.music.score import Note
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.unknown_robot import PLAYS
from cadenza.tasks.view import View

_GAIN = 0.8  # share of the errors of joints that is corrected
# Weight of squared changes of controls beside squared errors of joints, times the number of plays:
# in later plays, more of the errors is noise. Slides have little of it.
_COST, _COST_OF_SLIDES = 0.1, 0.003
_COST_OF_PLAN = 0.2  # the same before the first play
_WORSE = 0.15  # below the best score, more than by chance: practice goes back to the best play
_CLOSED_LOOP = 2  # plays, after which little more is learnt about the servos
_REDUCTION = 0.5  # factor of the corrections after a worse play


class _PlayInputs(NamedTuple):
    corrections: PressCorrections
    controls: Array
    """(T, A) differences from the start [m, rad]."""


class ScoredPlay(NamedTuple):
    """A play, and its scores by the notes heard."""

    actions: Array
    """(T, A) in actuator units, the pedal last."""
    f1: float
    note_onset_f1: float

    @property
    def score(self) -> float:
        """F1 and note onset F1."""
        return self.f1 + self.note_onset_f1


class Take(NamedTuple):
    """A play with what was heard and measured, and the corrections that it was played with."""

    scored: ScoredPlay
    notes: list[Note]
    """The notes that were heard, by the time of the song."""
    measured: Array
    """(T + 1, A) postures by the sensors, without their offset at the start."""
    inputs: _PlayInputs


class RobotPractice:
    """Practice of one song with one robot.

    Attributes:
        best: the best play so far, by the notes heard; None before the first.
        response: the response of the servos, as identified so far.
        sensors_late: the delay of the sensors [s].
    """

    def __init__(
        self, plan: SongPlan, nominal: Episode, ranges: DomainRandomization, response: Response
    ) -> None:
        """Take a plan, its episode on the nominal robot, and the ranges of robots.

        The ranges give the errors of place of keyboard and hands, and the delay of sensors;
        `response` is the response of the servos as known so far.
        """
        self._track, scene = plan.track, plan.scene
        self._dt, self._servos = self._track.config.control_timestep, servos_of(scene)
        joints = np.concatenate([nominal["hand_qpos0"][None], nominal["hand_qpos"]])
        self._postures, self._played = joints @ self._servos.of_joints, nominal["action"]
        place = ranges.keyboard_offset + ranges.mount_offset
        self._notes = NoteCorrections(plan, self._postures, place)
        planned_controls = self._played[:, :-1] - self._postures[0]
        ones = np.ones(planned_controls.shape[1])
        self._nominal = self._servo_response(Response(0.0, ones, np.inf * ones))
        self._moved = self._nominal.to(planned_controls)
        self._cost = np.where(self._servos.slides, _COST_OF_SLIDES, _COST)
        self.response = response
        self.sensors_late = sum(ranges.observation_latency) / 2
        self._robot = self._servo_response(self.response)
        before = self._robot.limited(planned_controls)
        change = self._moved - self._robot.to(before)
        controls = self._robot.controls(before, change, _COST_OF_PLAN * ones)
        self._inputs, self._share = _PlayInputs(self._notes.none(), controls), 1.0
        self.best: Take | None = None
        self._plays = 0
        self._usual = usual_response(self._servos, self._dt, ranges).fastest
        self._tracked = list[tuple[Array, Array]]()

    def _servo_response(self, response: Response) -> ServoResponse:
        return ServoResponse(self._servos, self._dt, response)

    def actions(self) -> Array:
        """(T, A) the actions of the next play."""
        controls = self._servos.clip(self._postures[0] + self._inputs.controls)
        return np.column_stack([controls, self._played[:, -1]])

    def learn(self, play: Play) -> Take:
        """Learn from a play of `actions`, and return it with its scores."""
        seconds, late = len(play.actions) * self._dt, self.sensors_late
        notes = notes_heard(play.messages, seconds, late)
        measured = play.joints @ self._servos.of_joints
        # The true start is known: what sensors show beside it is their offset.
        measured += self._postures[0] - measured[0]
        scored = ScoredPlay(play.actions, *scores_heard(self._track, notes))
        take = Take(scored, notes, measured, self._inputs)
        self._plays += 1
        self._notes.locate(notes, measured)
        self._identify(take)
        if self.best is None or scored.score >= self.best.scored.score:
            self.best, self._share = take, 1.0
        learn_from = take
        if scored.score < self.best.scored.score - _WORSE:
            learn_from, self._share = self.best, self._share * _REDUCTION
        self._inputs = self._inputs_after(learn_from)
        return take

    def _identify(self, take: Take) -> None:
        sent = take.scored.actions[:, :-1] - self._postures[0]
        self._tracked.append((sent, take.measured[1:] - self._postures[1:] + self._moved))
        late = self.response.late + self.sensors_late if self.best else None
        response = identified(self._servos, self._dt, self._tracked, self._usual, late)
        self.sensors_late = min(self.sensors_late, response.late)
        self.response = response._replace(late=response.late - self.sensors_late)
        self._robot = self._servo_response(self.response)

    def _target(self, corrections: PressCorrections) -> Array:
        """Target postures (T, A) after each step of a play with its corrections."""
        strikes = self._nominal.to(self._notes.strikes(corrections))
        return self._notes.postures(corrections)[1:] + strikes

    def _inputs_after(self, take: Take) -> _PlayInputs:
        """Corrections and controls of the next play, by those of a play and its errors."""
        before = take.inputs.corrections
        corrections = self._notes.corrected(before, take.notes, take.measured, self._share)
        target, measured = self._target(before), take.measured
        late = self.sensors_late / self._dt  # sensors show an earlier state
        after = np.concatenate([measured[2:], measured[-1:]])
        error = target - (1 - late) * measured[1:] - late * after
        change = self._share * _GAIN * error + self._target(corrections) - target
        sent = take.scored.actions[:, :-1] - self._postures[0]
        return _PlayInputs(
            corrections, self._robot.controls(sent, change, self._cost * self._plays)
        )


def learn_in_ten_plays(
    robot: Robot, view: View, plan: SongPlan, nominal: Episode, ranges: DomainRandomization
) -> Iterator[ScoredPlay]:
    """Play a song ten times on a robot, and once more as in the best play.

    The first plays are the generalist's in closed loop, if it knows these hands. The others
    practise the planner's performance on the nominal robot.

    Args:
        robot: the driver of the robot.
        view: a view before the first step on the nominal robot.
        plan: the planner's plan.
        nominal: its episode on the nominal robot.
        ranges: the ranges from which robots are drawn.
    """
    track, num_steps = plan.track, int(view.num_steps[0])
    dt = track.config.control_timestep
    response = usual_response(servos_of(plan.scene), dt, ranges)
    policies = list[tuple[float, Callable[[], Act]]]()
    if ClosedLoop.knows(view):
        closed = ClosedLoop(view, ranges)
        for _ in range(_CLOSED_LOOP):
            policy: Callable[[], Act] = partial(closed.acting, closed.response)
            result = play(robot, num_steps, policy())
            take = ScoredPlay(result.actions, *closed.learn(result))
            policies.append((take.score, policy))
            yield take
        response = closed.response
    practice = RobotPractice(plan, nominal, ranges, response)
    while len(policies) < PLAYS:
        policy = partial(in_turn, practice.actions())
        take = practice.learn(play(robot, num_steps, policy())).scored
        policies.append((take.score, policy))
        yield take
    _, best = max(policies, key=lambda scored: scored[0])
    result = play(robot, num_steps, best())
    notes = notes_heard(result.messages, num_steps * dt, practice.sensors_late)
    yield ScoredPlay(result.actions, *scores_heard(track, notes))
