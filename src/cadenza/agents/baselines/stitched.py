"""Songs played open loop, from motions of each hand that are planned once and stitched together."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, PlannerPerEnv, Progress
from cadenza.agents.baselines.motions import Motions, stitched
from cadenza.agents.baselines.plan_follower import PlanFollower
from cadenza.agents.planner.plan.fingertip_targets import targets_of
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner, PostureTrajectory
from cadenza.agents.planner.plan.presses import RISE
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.errors import CadenzaError
from cadenza.scene.scene import build_scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.view import View

# Share of the acceleration with which the planner's hands jump: it can correct landings that fail.
_ACCELERATION = 0.2
# Times the force that a white key takes. A fingertip would slip off a black one.
_WHITE_KEY_FORCE = 1.5


class Stitched(PlannerPerEnv[PlanFollower]):
    """An agent that plans everything when an episode begins, and plays it without feedback.

    Nothing is random. It reports the progress of "fingers" and "motions".
    """

    def begin(self, view: View, rng: np.random.Generator) -> PlanFollower:
        (track,) = view.tracks
        with threadpool_limits(1):  # small matrices, and the same bits everywhere
            plan = _plan(track, view.state.hand_qpos[0], self.progress)
        tracking = plan.nominal.tracking
        return PlanFollower(plan, tracking._replace(gain=np.zeros_like(tracking.gain)))


def _plan(track: GoalTrack, start: Array, progress: Progress) -> SongPlan:
    """Plan a song for hands whose joints begin at `start` (J,) [m, rad].

    Raises CadenzaError if there are no hands in the scene, or they do not slide along the keyboard.
    """
    if not track.scene.sides:
        raise CadenzaError("cannot plan: this scene has no hands")
    track = track.with_found_fingers().fingered(partial(progress, "fingers"))
    goals, dt, scene = track.goals, track.config.control_timestep, build_scene(track.scene.config)
    if not servos_of(scene).along_keyboard:
        raise CadenzaError(
            "agent stitched moves hands along the keyboard, which these cannot: "
            "add tx to --forearm-dofs, or choose another agent"
        )
    open_loop = replace(scene.hand.jump_times.accelerated(_ACCELERATION), next_key=RISE)
    planner = MotionPlanner(scene, dt, open_loop)
    presses = planner.presses(goals.fingers)
    before, states = planner.still(start, 0), goals.num_steps + 1
    postures = np.empty((states, len(scene.actuator_names)))
    for side in scene.sides:
        hand = hand_alone(scene, side)
        side_presses = [press for press in presses if press.side == side]
        motions = Motions(hand.scene, dt, progress)
        postures[:, hand.servos] = stitched(
            side_presses, motions, before.postures[0, hand.servos], states
        )
    targets = targets_of(scene, presses, states, dt)
    for press in presses:
        if not scene.keyboard.is_black[press.key]:
            targets.force[press.first : press.last, press.finger] *= _WHITE_KEY_FORCE
    solved = PostureTrajectory(postures, postures, targets)
    return SongPlan(scene, track, goals, planner.track(before, presses, solved))
