"""A song on a robot that nobody knows: ten plays, of which the best is played once more."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.robot.closed_loop import ClosedLoop
from cadenza.agents.robot.practice import RobotPractice
from cadenza.agents.robot.protocol import Act, Robot, in_turn, notes_heard, play, scores_heard
from cadenza.agents.robot.servo_response import usual_response
from cadenza.episode import Episode
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.unknown_robot import PLAYS
from cadenza.tasks.view import View

_CLOSED_LOOP = 2  # plays, after which little more is found of the servos


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
