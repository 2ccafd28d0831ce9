"""Plays any score by its plan, and what it has learnt about plans: nothing is searched.

The plan is inverse kinematics of the song, with feedback. What goes wrong with such plans is much
the same in all music: a finger is caught, a thumb comes late. Networks correct them, the same for
both hands, which have learnt from the planner's search over many songs, and by reinforcement. With
hands that they do not know, plans are rehearsed in simulation instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv, steps_in
from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.generalist.receding_plan import RecedingPlanner
from cadenza.agents.generalist.rehearsed_hand import RehearsedHand
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner
from cadenza.agents.planner.plan.song_plan import SongPlan, planning_scene, song_plans
from cadenza.agents.planner.plan.strike_model import planned_strikes
from cadenza.agents.planner.planner import PlanPlayer, SongPlanner
from cadenza.agents.planner.search.networks.inputs import sizes_of
from cadenza.agents.planner.search.networks.weights import Weights, shipped
from cadenza.configs import check_ranges, whole_number
from cadenza.errors import CadenzaError
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import GoalTrack, players_of
from cadenza.tasks.view import View

JUMP_ACCELERATION = 2.0
"""The factor of the acceleration with which hands jump where networks correct their landings."""

_LEARNT = Path(__file__).parent
_DEFAULT_REHEARSALS, _MAX_REHEARSALS = 4, 100


class Generalist(PlannerPerEnv["SongPlanner | SightReader"]):
    """Corrects the plan of a song, or of what is in sight of it, by what it has learnt from others.

    It reports the progress of "fingers" and "postures".
    """

    def __init__(self, config: GeneralistConfig | None = None) -> None:
        """Checks the options.

        Raises:
            CadenzaError: an option makes no sense.
        """
        super().__init__()
        self.config = config or GeneralistConfig()
        if self.config.look_ahead is not None:
            check_ranges(self.config, {"look_ahead": (0.2, 10.0)})
        if self.config.rehearsals is not None:
            whole_number(self.config.rehearsals, "rehearsals", 0, _MAX_REHEARSALS)
        for other in ("weights", "look_ahead"):
            if self.config.rehearsals and getattr(self.config, other) is not None:
                raise CadenzaError(
                    f"generalist: does not rehearse with {other}: leave out one of the two"
                )

    def begin(self, view: View, rng: np.random.Generator) -> SongPlanner | SightReader:
        (track,) = view.tracks
        config, scene = self.config, planning_scene(track)
        if config.look_ahead is not None:
            return SightReader(track, view.state, config.look_ahead, self._weights(scene))
        rehearsals = self._rehearsals(scene)
        weights = None if rehearsals else self._weights(scene)
        plans = song_plans(
            track.with_found_fingers(),
            view.state.hand_qpos[0],
            self.progress,
            jump_acceleration=1.0 if weights is None else JUMP_ACCELERATION,
            strikes=True,
        )

        def hands_for(plan: SongPlan) -> Sequence[PlanPlayer]:
            if weights is not None:
                return [CorrectedHands(plan, weights)]
            return [RehearsedHand(plan, side, rehearsals) for side in plan.scene.sides]

        return SongPlanner(plans, hands_for)

    def _rehearsals(self, scene: Scene) -> int:
        """The number of changes of each half second of the plan; with 0, networks correct it."""
        if self.config.rehearsals is not None:
            return self.config.rehearsals
        known = shipped_for(scene)
        fits = known is not None and known.sizes == sizes_of(scene)
        return 0 if self.config.weights is not None or fits else _DEFAULT_REHEARSALS

    def _weights(self, scene: Scene) -> Weights:
        """The networks for the hands of a scene.

        Raises:
            CadenzaError: there are none for them, or the file is damaged.
        """
        own = self.config.weights
        weights = shipped_for(scene) if own is None else Weights.load(Path(own))
        if weights is None:
            raise CadenzaError(
                f"generalist: has not learnt to play with hand {scene.hand.name}; choose from "
                f"{', '.join(sorted(shipped(_LEARNT)))}, or another agent"
            )
        inputs, servos = sizes_of(scene)
        if weights.sizes != (inputs, servos):
            raise CadenzaError(
                f"generalist: has learnt with hands of {weights.sizes[1]} servos "
                f"({weights.sizes[0]} inputs of its networks); here they have {servos} ({inputs} "
                "inputs): leave out options that change the hands"
            )
        return weights


class SightReader(EpisodePlanner):
    """Plays one song, of which it knows only what is in sight.

    In sight are the goals of the step that it decides on and of those that it looks ahead: no
    fingers, no ends of notes further ahead, nothing of how long the song is.
    """

    def __init__(self, track: GoalTrack, start: State, look_ahead: float, weights: Weights) -> None:
        """Plans what is in sight at the beginning, from the state of one simulation.

        Goals are known for the time `look_ahead` [s].
        """
        dt = track.config.control_timestep
        self._track, self._goals = track, track.goals
        self._ahead = np.arange(steps_in(look_ahead, dt) + 1)
        self._scene = planning_scene(track)
        self._strikes = planned_strikes(self._goals.onsets, self._scene.keyboard, dt)
        times = self._scene.hand.jump_times.accelerated(JUMP_ACCELERATION)
        motion = MotionPlanner(self._scene, dt, times)
        players = players_of(self._scene)
        self._receding = RecedingPlanner(self._scene, motion, players, start.hand_qpos[0], dt)
        self._hands = CorrectedHands(self._plan_from(0, start), weights)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        while self._planned < step:  # once, unless others have played
            self._hands.follow(self._plan_from(self._planned + 1, view.state), 0)
        ctrl = self._hands.act(step - self._planned, view.state)
        return np.append(ctrl, self._goals.sustain[step])

    def _plan_from(self, step: int, state: State) -> SongPlan:
        """Plans what is in sight at a step, which is the first of the plan."""
        self._planned = step
        keys, _ = self._goals.at(step + self._ahead)
        strikes = self._strikes.by_place(step, step + len(keys))
        nominal = self._receding.replan(step, keys, strikes, state.fingertip_xpos[0])
        return SongPlan(self._scene, self._track, replace(self._goals, keys=keys), nominal)


def shipped_for(scene: Scene) -> Weights | None:
    """The networks that come with the package for the hands of a scene, if any do."""
    return shipped(_LEARNT).get(scene.hand.name)
