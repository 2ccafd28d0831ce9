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
from cadenza.agents.lateness import EarlyPlanner, early
from cadenza.agents.planner.plan.hand_goals import ABOUT_TO_PRESS, HandGoals
from cadenza.agents.planner.plan.nominal_trajectory import MotionPlanner
from cadenza.agents.planner.plan.song_plan import SongPlan, planning_scene, song_plans
from cadenza.agents.planner.plan.strike_model import planned_strikes
from cadenza.agents.planner.planner import PlanPlayer, SongPlanner
from cadenza.agents.planner.search.hand_rehearsal import HandRehearsal, RehearsalConfig
from cadenza.agents.planner.search.networks.inputs import sizes_of
from cadenza.agents.planner.search.networks.weights import Weights, shipped
from cadenza.configs import check_ranges, whole_number
from cadenza.errors import CadenzaError
from cadenza.fingers import Side
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation
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
            track.with_found_fingers(),
            view.state.hand_qpos[0],
            self.progress,
            strikes=True,
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


_REHEARSAL = RehearsalConfig(
    window=0.5, cost_after=0.5, updated_after=0.7, max_mistakes=1.0, refinements=3
)
_AS_FORESEEN = 1e-3  # [rad] from the key's angle in the rehearsal, within which its speed is known


class RehearsedHand:
    """A hand that plays a plan.

    It rehearses each half second by itself, from its state when the half second begins. Within it,
    feedback makes up for what the rehearsal does not foresee, such as contact with the other hand.

    Attributes:
        servos: the hand's servos among those of the scene.
        joints: the hand's joints among those of the scene.
        rehearsal: the rehearsal of the current half second.
        lookahead: the number of steps of the plan that are needed.
    """

    def __init__(self, plan: SongPlan, side: Side, rehearsals: int) -> None:
        """Follow a plan, and change each half second of it at most `rehearsals` times."""
        dt = plan.track.config.control_timestep
        self._side = side
        alone, self.servos, self.joints = hand_alone(plan.scene, side)
        self._servos, self._simulation = servos_of(alone), PlanningSimulation(alone, 1, dt)
        config = _REHEARSAL._replace(iterations=rehearsals + 1)
        self.rehearsal = HandRehearsal(alone, HandRollouts(alone, dt), dt, config)
        self.lookahead = self.rehearsal.lookahead + steps_in(ABOUT_TO_PRESS, dt)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""
        self._goals = HandGoals(plan, self._side)
        tracking = plan.nominal.tracking.of(self.servos)
        self._tracking = tracking._replace(ctrl=tracking.ctrl.copy())

    def act(self, step: int, state: State) -> Array:
        """Next controls (A,)."""
        qpos, qvel = state.hand_qpos[0, self.joints], state.hand_qvel[0, self.joints]
        if step >= self.rehearsal.end:
            key_qpos = state.key_qpos[0]
            self._simulation.set_joints(qpos, qvel, key_qpos, self._key_qvel(key_qpos))
            self._rehearse(step)
        feedback = self._tracking.feedback(step, self._servos.state(qpos, qvel))
        return self._servos.clip(self.rehearsal.ctrl(step)[0] - feedback)

    def _rehearse(self, step: int) -> None:
        """Rehearse the steps from `step` on."""
        last = min(step + self.rehearsal.lookahead, len(self._tracking.ctrl))
        rows = np.arange(step, last)
        if step == self.rehearsal.end:  # the last rehearsal has changed the first of these steps
            tail = self.rehearsal.tail
            self._tracking.ctrl[step : step + len(tail)] = tail
        self.rehearsal.rehearse(self._goals, self._tracking, rows, self._simulation)

    def _key_qvel(self, key_qpos: Array) -> Array:
        """Speeds (K,) of keys at `key_qpos` (K,), which no sensor measures.

        They are those of the rehearsal where its keys are here, and 0 elsewhere.
        """
        speeds, keys = np.zeros_like(key_qpos), self.rehearsal.keys
        qpos, qvel = self.rehearsal.keys_at_end
        speeds[keys] = np.where(np.abs(key_qpos[keys] - qpos) < _AS_FORESEEN, qvel, 0.0)
        return speeds
