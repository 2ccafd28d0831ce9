"""The generalist, which plays any score by a plan that networks correct, without search.

The plan is inverse kinematics of the song, with feedback. Such plans fail in much the same ways in
all music: a finger is caught, a thumb comes late. Networks correct this. They are the same for both
hands, and have learnt from the planner's search over many songs, and by reinforcement. Hands that
the networks do not know rehearse their plans in simulation instead.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv, steps_in
from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.generalist.corrected_hands import CorrectedHands
from cadenza.agents.generalist.receding_plan import RecedingPlanner
from cadenza.agents.generalist.rehearsed_hand import RehearsedHand
from cadenza.agents.lateness import EarlyPlanner, early
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

_LEARNT = Path(__file__).parent
_DEFAULT_REHEARSALS, _MAX_REHEARSALS = 4, 100


Player: TypeAlias = "SongPlanner | SightReader"


class Generalist(PlannerPerEnv["Player | EarlyPlanner[Player]"]):
    """An agent that corrects the plan of a song, or of what is in sight of it, by networks.

    It reports the progress of "fingers" and "postures".
    """

    def __init__(self, config: GeneralistConfig | None = None) -> None:
        """Check the options, and raise a `CadenzaError` if one makes no sense."""
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

    def begin(self, view: View, rng: np.random.Generator) -> Player | EarlyPlanner[Player]:
        return early(view, self._begin)

    def _begin(self, view: View) -> Player:
        (track,) = view.tracks
        config, scene = self.config, planning_scene(track)
        if config.look_ahead is not None:
            return SightReader(track, view.state, config.look_ahead, self._weights(scene))
        rehearsals = self._rehearsals(scene)
        weights = None if rehearsals else self._weights(scene)
        plans = song_plans(
            track.with_found_fingers(), view.state.hand_qpos[0], self.progress, strikes=True
        )

        def hands_for(plan: SongPlan) -> Sequence[PlanPlayer]:
            if weights is not None:
                return [CorrectedHands(plan, weights)]
            return [RehearsedHand(plan, side, rehearsals) for side in plan.scene.sides]

        return SongPlanner(plans, hands_for)

    def _rehearsals(self, scene: Scene) -> int:
        """Number of changes of each half second of the plan; with 0, networks correct it."""
        if self.config.rehearsals is not None:
            return self.config.rehearsals
        has_networks = self.config.weights is not None or knows_hands(scene)
        return 0 if has_networks else _DEFAULT_REHEARSALS

    def _weights(self, scene: Scene) -> Weights:
        """Networks for the hands of a scene.

        Raises CadenzaError if there are none for them, or the file is damaged.
        """
        path = self.config.weights
        weights = shipped_for(scene) if path is None else Weights.load(Path(path))
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
    """A player of one song that knows only the music in sight.

    In sight are the goals of the current step and of the steps that it looks ahead, but no fingers,
    no later ends of notes, and not the length of the song.
    """

    def __init__(self, track: GoalTrack, start: State, look_ahead: float, weights: Weights) -> None:
        """Plan the music in sight at the beginning, `look_ahead` [s]."""
        dt = track.config.control_timestep
        self._track, self._goals = track, track.goals
        self._ahead = np.arange(steps_in(look_ahead, dt) + 1)
        self._scene = planning_scene(track)
        self._strikes = planned_strikes(self._goals.onsets, self._scene, dt)
        motion, players = MotionPlanner(self._scene, dt), players_of(self._scene)
        self._receding = RecedingPlanner(self._scene, motion, players, start.hand_qpos[0], dt)
        self._hands = CorrectedHands(self._plan_from(0, start), weights)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        while self._first < step:  # once, unless another agent has acted meanwhile
            self._hands.follow(self._plan_from(self._first + 1, view.state), 0)
        ctrl = self._hands.act(step - self._first, view.state)
        return np.append(ctrl, self._goals.sustain[step])

    def _plan_from(self, step: int, state: State) -> SongPlan:
        """Plan the music in sight at a step, which is the first of the plan."""
        self._first = step
        keys, _ = self._goals.at(step + self._ahead)
        strikes = self._strikes.by_place(step, step + len(keys))
        nominal = self._receding.replan(step, keys, strikes, state.fingertip_xpos[0])
        return SongPlan(self._scene, self._track, replace(self._goals, keys=keys), nominal)


def shipped_for(scene: Scene) -> Weights | None:
    """The networks that come with the package for the hands of a scene, None without any."""
    return shipped(_LEARNT).get(scene.hand.name)


def knows_hands(scene: Scene) -> bool:
    """Whether the networks that come with the package have learnt to play with these hands."""
    weights = shipped_for(scene)
    return weights is not None and weights.sizes == sizes_of(scene)
