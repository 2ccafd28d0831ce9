"""Plays any score by its plan and what it has learnt about plans: nothing is searched.

The plan is inverse kinematics of the song, with feedback, rehearsed in simulation. What goes wrong
with such plans is much the same in all music: a finger is caught, a thumb comes late. What corrects
them, the same for both hands, has been learnt from the planner's search over many songs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from cadenza.agents.agent import Array, PlannerPerEnv
from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.generalist.corrected_hand import CorrectedHand
from cadenza.agents.generalist.rehearsal import Rehearsal
from cadenza.agents.generalist.weights import Weights, weights_of
from cadenza.agents.planning.control_steps import steps_in
from cadenza.agents.planning.in_sight import InSight
from cadenza.agents.planning.song_plan import SongPlan, scene_planned_with, song_plans
from cadenza.configs import check_ranges, whole_number
from cadenza.errors import CadenzaError
from cadenza.sim.protocol import State
from cadenza.tasks.goal_track import GoalTrack, players_of
from cadenza.tasks.view import View

_MOST_REHEARSALS = 100


class Generalist(PlannerPerEnv["GeneralistSong | SightReader"]):
    """Corrects the plan of a song, or of what is in sight of it, by what it has learnt from others.

    Its progress is that of "fingers" and "postures".
    """

    def __init__(self, config: GeneralistConfig | None = None) -> None:
        """Raises:
        CadenzaError: an option makes no sense.
        """
        super().__init__()
        self.config = config or GeneralistConfig()
        if self.config.look_ahead is not None:
            check_ranges(self.config, {"look_ahead": (0.2, 10.0)})
        whole_number(self.config.rehearsals, "rehearsals", 0, _MOST_REHEARSALS)

    def begin(self, view: View, rng: np.random.Generator) -> GeneralistSong | SightReader:
        """Raises:
        CadenzaError: there are no hands in the scene, it has not learnt to play with them, or what
            it has learnt is damaged.
        """
        (track,) = view.tracks
        own = self.config.weights
        weights = weights_of(view.task.scene) if own is None else Weights.load(Path(own))
        if self.config.look_ahead is not None:
            return SightReader(track, view.state, self.config.look_ahead, weights)
        plans = song_plans(track.with_found_fingers(), view.state.hand_qpos[0], self.progress)
        return GeneralistSong(plans, view.state, weights, self.config.rehearsals)


class GeneralistSong:
    """Plays one song.

    Attributes:
        plan: without corrections, as far as it goes; all of it when the song is over.
    """

    plan: SongPlan

    def __init__(
        self, plans: Iterator[SongPlan], start: State, weights: Weights, rehearsals: int
    ) -> None:
        """Args:
        plans: of the song, each longer than the one before.
        start: the first of its states is where the hands begin.
        weights: what corrects them.
        rehearsals: how often each part is rehearsed.

        Raises:
            CadenzaError: it has learnt with other servos.
        """
        self._plans, self._weights, self._rehearsals = plans, weights, rehearsals
        self.plan = next(plans)
        self._hands = corrected_hands(self.plan, weights)
        self._rehearsal = Rehearsal(self.plan, start, weights)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        while step >= self._rehearsal.steps:
            self._go_on(step)
        action = np.zeros(view.task.action_size)
        action[-1] = self.plan.goals.sustain[step]
        for hand in self._hands:
            action[hand.servos] = hand.act(step, view.state, self._weights)
        return action

    def _go_on(self, step: int) -> None:
        """Plans and rehearses what comes from that step on."""
        while not self.plan.complete and self.plan.nominal.num_steps < self._rehearsal.needed:
            self.plan = next(self._plans)
        part = self._rehearsal.further(self.plan, self._rehearsals)
        for hand in self._hands:
            hand.follow(part, step)


class SightReader:
    """Plays one song, of which it knows only what is in sight.

    That are the goals of the step that it decides on and of those that it looks ahead: no fingers,
    no ends of notes that are beyond, nothing of how long the song is.
    """

    def __init__(self, track: GoalTrack, start: State, look_ahead: float, weights: Weights) -> None:
        """Args:
        track: what is played.
        start: of one simulation.
        look_ahead: how far ahead it knows the goals [s].
        weights: what corrects its plans.
        """
        dt = track.config.control_timestep
        self._track, self._goals, self._weights = track, track.goals, weights
        self._ahead = np.arange(steps_in(look_ahead, dt) + 1)
        self._scene = scene_planned_with(track)
        self._in_sight = InSight(self._scene, players_of(self._scene), start.hand_qpos[0], dt)
        self._looked, plan = 0, self._look(0, start)
        self._hands = corrected_hands(plan, weights)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        while step >= self._looked + self._in_sight.every:  # once, unless others have played
            plan = self._look(self._looked + self._in_sight.every, view.state)
            for hand in self._hands:
                hand.follow(plan, 0)
        action = np.zeros(view.task.action_size)
        action[-1] = self._goals.sustain[step]
        for hand in self._hands:
            action[hand.servos] = hand.act(step - self._looked, view.state, self._weights)
        return action

    def _look(self, step: int, state: State) -> SongPlan:
        """The plan of what is in sight at a step; its first step is this one."""
        self._looked = step
        keys, _ = self._goals.at(step + self._ahead)
        nominal = self._in_sight.look(step, keys, state.fingertip_xpos[0])
        return SongPlan(self._scene, self._track, replace(self._goals, keys=keys), nominal)


def corrected_hands(plan: SongPlan, weights: Weights) -> list[CorrectedHand]:
    """Those of a plan.

    Raises:
        CadenzaError: it has been learnt with other servos.
    """
    hands = [CorrectedHand(plan, side) for side in plan.scene.sides]
    for hand in hands:
        if hand.sizes != weights.sizes:
            raise CadenzaError(
                f"generalist: has learnt with hands of {weights.sizes[1]} servos, but here "
                f"they have {hand.sizes[1]}: leave out options that change the hands"
            )
    return hands
