"""The generalist on a robot that nobody knows, in closed loop: each play tells how servos respond.

It plans for a model whose servos lag as those of the robot do, as far as is known, and is as early
as the robot is late.
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
        response: how servos respond, as far as it is known.
        sensors_late: for how long what is measured is on its way [s].
    """

    def __init__(self, view: View, known: DomainRandomization) -> None:
        """Take a view before the first step on the nominal robot, and how robots are drawn."""
        (track,) = view.tracks
        self._view, self._track = view, track.with_found_fingers()
        self._scene, self._start = planning_scene(track), view.state.hand_qpos[0]
        self._dt, self._servos = track.config.control_timestep, servos_of(self._scene)
        self.response, self._known = usual_response(self._servos, self._dt, known), known
        self._usual = self.response.fastest
        self.sensors_late = sum(known.observation_latency) / 2
        self._plays = list[tuple[Array, Array]]()

    @staticmethod
    def knows(view: View) -> bool:
        """Whether the generalist knows the hands at this piano, and has time to be early."""
        (track,) = view.tracks
        scene = planning_scene(track)
        return knows_hands(scene) and scene.config.hands != "apart" and track.silent_steps > 0

    def acting(self, response: Response) -> Act:
        """How to act in a play on a robot whose servos have this lag.

        It is as early as is usual, whatever the delay: strikes then begin in the midst of a control
        step, from which they may be off to either side.
        """
        late = Lateness.expected(self._known) or Lateness(0.0, 0.0, (0.0, 0.0, 0.0))
        scene = with_servo_damping(self._scene, response.damping)
        view = replace(self._view, tracks=(replace(self._track, scene=scene),))
        weights = shipped_for(scene)

        def begin(early: View) -> SongPlanner:
            (track,) = early.tracks
            plans = song_plans(track, self._start, strikes=True, scene=scene)
            return SongPlanner(plans, lambda plan: [CorrectedHands(plan, weights)])

        player, off = EarlyPlanner(view, late, begin), np.zeros_like(self._start)
        unmeasured = view.state._replace(
            hand_qvel=np.full_like(view.state.hand_qvel, np.nan),
            key_qpos=np.full_like(view.state.key_qpos, np.nan),
        )

        def act(step: int, joints: Array) -> Array:
            nonlocal off
            if not step:  # the hands begin where they are put
                off = joints - self._start
            state = unmeasured._replace(hand_qpos=(joints - off)[None])
            return player.act(replace(view, state=state, steps=np.array([step])))

        return act

    def learn(self, play: Play) -> tuple[float, float]:
        """Find how servos respond, and return F1 and note onset F1 as heard.

        It is the response that explains how joints have moved otherwise than in simulation.
        """
        sent = play.actions[:, :-1] - self._start @ self._servos.of_joints
        measured = (play.joints[1:] - play.joints[0]) @ self._servos.of_joints
        first, late = not self._plays, self.response.late + self.sensors_late
        expected = ServoResponse(self._servos, self._dt, self.response._replace(late=late))
        setpoints = expected.limited(sent)
        moved = measured - self._simulated(setpoints, late) + expected.to(setpoints)
        self._plays.append((sent, moved))
        known = None if first else late
        found = identified(self._servos, self._dt, self._plays, self._usual, known)
        actions_late = float(np.clip(found.late - self.sensors_late, *self._known.latency))
        self.sensors_late = max(found.late - actions_late, 0.0)
        self.response = found._replace(late=actions_late)
        seconds = len(sent) * self._dt
        return scores_heard(self._track, notes_heard(play.heard, seconds, self.sensors_late))

    def _simulated(self, setpoints: Array, late: float) -> Array:
        """(T, A) how the robot moves, as far as it is known, by setpoints (T, A) that are late.

        Both are differences from where it begins.
        """
        scene = with_servo_damping(self._scene, self.response.damping)
        model, rest = PlanningSimulation(scene, 1, self._dt), self._start @ self._servos.of_joints
        model.set_joints(self._start, np.zeros_like(self._start), self._view.state.key_qpos[0])
        whole, part = divmod(round(late / scene.model.opt.timestep), model.num_substeps)
        sent = np.concatenate([np.zeros((whole + 1, len(rest))), setpoints]) + rest
        joints = []
        for before, now in pairwise(sent[: len(setpoints) + 1]):
            model.step(now[None], None, HeldControls(before[None], np.array([part])))
            joints.append(model.state.hand_qpos[0] - self._start)
        return np.array(joints) @ self._servos.of_joints
