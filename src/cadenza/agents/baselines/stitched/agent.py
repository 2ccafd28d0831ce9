"""Plays a song with motions that are planned once and stitched together, open loop."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Array, PlannerPerEnv, Progress
from cadenza.agents.baselines.stitched.motions import Motions
from cadenza.agents.baselines.stitched.stitching import stitched
from cadenza.agents.planner.plan.fingertip_targets import targets_of
from cadenza.agents.planner.plan.inverse_kinematics import rest_posture
from cadenza.agents.planner.plan.nominal_trajectory import (
    NominalTrajectory,
    controls_along,
    forearm_places,
)
from cadenza.agents.planner.plan.presses import RISE, Press, presses_of
from cadenza.agents.planner.plan.release_times import let_go_in_time
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.errors import CadenzaError
from cadenza.fingers import NO_FINGER
from cadenza.hands.hand import Hand
from cadenza.music.goals import Goals
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene, build_scene, hand_alone
from cadenza.scene.servos import Reaction, Servos, servos_of
from cadenza.tasks.goal_track import GoalTrack
from cadenza.tasks.view import View

# Of the acceleration with which the planner's hands jump, and of how far they reach without a
# jump: it can mend landings that fail.
_UNHURRIED, _NEAR = 0.125, 0.7
# Times what a white key takes. A fingertip would slip off a black one.
_FIRMLY = 1.5


class Stitched(PlannerPerEnv["StitchedSong"]):
    """Plans everything when an episode begins, and then does not look.

    Nothing is random. Its progress is that of "fingers" and "motions".
    """

    def begin(self, view: View, rng: np.random.Generator) -> StitchedSong:
        """Raises:
        CadenzaError: there are no hands in the scene, or they do not slide along the keyboard.
        """
        return StitchedSong(view, self.progress)


class StitchedSong:
    """Plays one song.

    Attributes:
        plan: of all of it.
    """

    def __init__(self, view: View, progress: Progress) -> None:
        """Args:
            view: of the first step, of one environment.
            progress: is told of "fingers" and "motions".

        Raises:
            CadenzaError: there are no hands in the scene, or they do not slide along the keyboard.
        """
        (track,) = view.tracks
        with threadpool_limits(1):  # small matrices, and the same bits everywhere
            self.plan = _planned(track, view.state.hand_qpos[0], progress)
        self._pedal = self.plan.goals.sustain.astype(np.float64)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        return np.append(self.plan.nominal.tracking.ctrl[step], self._pedal[step])


def _planned(track: GoalTrack, start: Array, progress: Progress) -> SongPlan:
    """How hands whose joints begin at `start` (J,) [m, rad] play all of a song."""
    if not track.scene.sides:
        raise CadenzaError("cannot plan: this scene has no hands")
    track = track.with_found_fingers().fingered(partial(progress, "fingers"))
    goals, dt, scene = track.goals, track.config.control_timestep, build_scene(track.scene.config)
    servos = servos_of(scene)
    if not servos.along_keyboard:
        raise CadenzaError(
            "agent stitched moves hands along the keyboard, which these cannot: "
            "add tx to --forearm-dofs, or choose another agent"
        )
    kinematics = Kinematics(scene, servos)
    presses = _presses(scene, servos, kinematics, goals, dt)
    here, states = start @ servos.of_joints, goals.num_steps + 1
    postures = np.empty((states, len(here)))
    for side in scene.sides:
        hand = hand_alone(scene, side)
        mine = [press for press in presses if press.side == side]
        motions = Motions(hand.scene, dt, progress)
        postures[:, hand.servos] = stitched(mine, motions, here[hand.servos], states)
    targets = targets_of(scene, presses, states, dt)
    for press in presses:
        if not scene.keyboard.is_black[press.key]:
            targets.force[press.first : press.last, press.finger] *= _FIRMLY
    at_rest = np.stack([here, np.zeros_like(here)], axis=1)
    fingertips, tracking = controls_along(
        scene,
        kinematics,
        servos,
        Reaction(scene, servos),
        targets,
        postures,
        postures[:0],
        at_rest,
        dt,
    )
    return SongPlan(scene, track, goals, NominalTrajectory(presses, postures, fingertips, tracking))


def _presses(
    scene: Scene, servos: Servos, kinematics: Kinematics, goals: Goals, dt: float
) -> list[Press]:
    """What hands hold when, which take their time to get from key to key."""
    fingers = np.where(scene.has_fingers(goals.fingers), goals.fingers, np.int8(NO_FINGER))
    places = forearm_places(scene, kinematics, rest_posture(servos))
    wanted = presses_of(goals.keys, fingers, scene.fingers)
    is_black = scene.keyboard.is_black
    return let_go_in_time(wanted, places, is_black, dt, _unhurried(scene.hand))


def _unhurried(hand: Hand) -> Hand:
    slower = hand.jump_times.hurried(_UNHURRIED)
    near = _NEAR * slower.within_reach
    # Onto black keys no sooner: that has cost more than it gained.
    return replace(hand, jump_times=replace(slower, within_reach=near, climb=RISE))
