"""The generalist in closed loop on a robot of unknown parameters.

Each play serves to identify the response of its servos. The generalist then plans for a model with
this response, and acts early by the delay of the robot.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.generalist.generalist import knows_hands, shipped_for
from cadenza.agents.lateness import EarlyPlanner, Lateness
from cadenza.agents.planner.plan.song_plan import planning_scene, song_plans
from cadenza.agents.planner.planner import SongPlanner
from cadenza.agents.robot.protocol import Act, Play, notes_heard, scores_heard
from cadenza.agents.robot.servo_response import Response, ServoResponse, identified, usual_response
from cadenza.scene.randomization import with_servo_damping
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import HeldControls
from cadenza.tasks.config import DomainRandomization
from cadenza.tasks.view import View


class ClosedLoop:
    """Plays of one song by the generalist on one robot.

    Attributes:
        response: the response of the servos, as identified so far.
        sensors_late: the delay of the sensors [s].
    """

    def __init__(self, view: View, ranges: DomainRandomization) -> None:
        """Take a view before the first step on the nominal robot, and the ranges of robots."""
        (track,) = view.tracks
        self._view, self._track = view, track.with_found_fingers()
        self._scene, self._start = planning_scene(track), view.state.hand_qpos[0]
        self._dt, self._servos = track.config.control_timestep, servos_of(self._scene)
        self.response, self._ranges = usual_response(self._servos, self._dt, ranges), ranges
        self._usual = self.response.fastest
        self.sensors_late = sum(ranges.observation_latency) / 2
        self._plays = list[tuple[Array, Array]]()

    @staticmethod
    def knows(view: View) -> bool:
        """Whether the generalist knows these hands, and has time to act early."""
        (track,) = view.tracks
        scene = planning_scene(track)
        return knows_hands(scene) and scene.config.hands != "apart" and track.silent_steps > 0

    def acting(self, response: Response) -> Act:
        """A policy for a play on a robot with this response.

        It acts early by the usual delay, also for robots with another one. Strikes then begin in
        the middle of a control step, with room for errors to either side.
        """
        late = Lateness.expected(self._ranges) or Lateness(0.0, 0.0, (0.0, 0.0, 0.0))
        scene = with_servo_damping(self._scene, response.damping)
        view = replace(self._view, tracks=(replace(self._track, scene=scene),))
        weights = shipped_for(scene)

        def begin(early: View) -> SongPlanner:
            (track,) = early.tracks
            plans = song_plans(track, self._start, strikes=True, scene=scene)
            return SongPlanner(plans, lambda plan: [CorrectedHands(plan, weights)])

        player, offset = EarlyPlanner(view, late, begin), np.zeros_like(self._start)
        unmeasured = view.state._replace(
            hand_qvel=np.full_like(view.state.hand_qvel, np.nan),
            key_qpos=np.full_like(view.state.key_qpos, np.nan),
        )

        def act(step: int, joints: Array) -> Array:
            nonlocal offset
            if not step:  # the true start is known: what sensors show beside it is their offset
                offset = joints - self._start
            state = unmeasured._replace(hand_qpos=(joints - offset)[None])
            return player.act(replace(view, state=state, steps=np.array([step])))

        return act

    def learn(self, play: Play) -> tuple[float, float]:
        """Identify the response of the servos, and return F1 and note onset F1 as heard.

        The response explains how joints have moved differently from the simulation.
        """
        sent = play.actions[:, :-1] - self._start @ self._servos.of_joints
        measured = (play.joints[1:] - play.joints[0]) @ self._servos.of_joints
        first, late = not self._plays, self.response.late + self.sensors_late
        expected = ServoResponse(self._servos, self._dt, self.response._replace(late=late))
        setpoints = expected.limited(sent)
        moved = measured - self._simulated(setpoints, late) + expected.to(setpoints)
        self._plays.append((sent, moved))
        known_delay = None if first else late
        response = identified(self._servos, self._dt, self._plays, self._usual, known_delay)
        actions_late = float(np.clip(response.late - self.sensors_late, *self._ranges.latency))
        self.sensors_late = max(response.late - actions_late, 0.0)
        self.response = response._replace(late=actions_late)
        seconds = len(sent) * self._dt
        return scores_heard(self._track, notes_heard(play.messages, seconds, self.sensors_late))

    def _simulated(self, setpoints: Array, late: float) -> Array:
        """Simulated positions (T, A) of servos for setpoints (T, A) that arrive `late` [s].

        Both are differences from the start.
        """
        scene = with_servo_damping(self._scene, self.response.damping)
        model, rest = PlanningSimulation(scene, 1, self._dt), self._start @ self._servos.of_joints
        model.set_joints(self._start, np.zeros_like(self._start), self._view.state.key_qpos[0])
        steps, part = divmod(round(late / scene.model.opt.timestep), model.num_substeps)
        sent = np.concatenate([np.zeros((steps + 1, len(rest))), setpoints]) + rest
        joints = []
        for before, now in pairwise(sent[: len(setpoints) + 1]):
            model.step(now[None], None, HeldControls(before[None], np.array([part])))
            joints.append(model.state.hand_qpos[0] - self._start)
        return np.array(joints) @ self._servos.of_joints
