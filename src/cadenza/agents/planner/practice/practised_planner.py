"""A planner that plays a song as it was practised."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv, check_planned_for
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.practice.losses import NOTE_WEIGHT
from cadenza.agents.planner.practice.plan_variants import Variant
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.errors import CadenzaError
from cadenza.scene.servos import servos_of
from cadenza.sim.threads import Threads
from cadenza.tasks.view import View

_PUSHED = 1e-4  # [m, rad] off the trajectory, up to which feedback alone leads back


class PractisedPlan(NamedTuple):
    """The controls and the variant with which a song is played as it was practised."""

    tracking: Tracking  # the controls, and the feedback that leads the hands back to the trajectory
    variant: Variant  # the fingers and the release times


class PracticeResult(NamedTuple):
    """A trajectory of the whole song, and its scores in the whole scene."""

    practised: PractisedPlan
    f1: float
    note_onset_f1: float  # at physics steps, as `cadenza play` counts it

    @property
    def score(self) -> float:
        """F1 and the weighted F1 of note onsets."""
        return self.f1 + NOTE_WEIGHT * self.note_onset_f1

    def no_worse_than(self, other: PracticeResult) -> bool:
        """Whether neither the score nor the F1 of note onsets is lower."""
        return self.score >= other.score and self.note_onset_f1 >= other.note_onset_f1


class PractisedPlanner(EpisodePlanner):
    """A planner of one song that plays it as it was practised.

    Feedback leads the hands back to the trajectory of practice. Once they are pushed too far off
    for that, it searches around that trajectory as the planner does.
    """

    def __init__(
        self,
        view: View,
        practised: PractisedPlan,
        rng: np.random.Generator,
        context: PlanningContext,
        plan: SongPlan | None = None,
    ) -> None:
        """Begin without a search, at the view before the first step of one environment.

        `plan` is the plan of this variant before practice, if there is one already. Raises
        CadenzaError if another song was practised, or with other hands.
        """
        (self._track,) = view.tracks
        self._tracking, self._variant = practised
        _check(practised, view)
        self._servos = servos_of(view.task.scene)
        self._start, self._pedal = view.state.hand_qpos[0].copy(), self._track.goals.sustain
        self._rng, self._context, self._plan = rng, context, plan
        self._search: HandsInScene | None = None

    def act(self, view: View) -> Array:
        state, step = view.state, int(view.steps[0])
        if not self._search:
            servo_state = self._servos.state(state.hand_qpos[0], state.hand_qvel[0])
            error = np.abs(servo_state - self._tracking.expected[step])[:, 0].max()
            if error <= _PUSHED:
                ctrl = self._tracking.controls(self._servos, step, servo_state)
                return np.append(ctrl, self._pedal[step])
            self._search = self._begin_search(step)
        return np.append(self._search.act(step, state), self._pedal[step])

    @property
    def plan(self) -> SongPlan:
        """The plan before practice; made on first use."""
        if self._plan is None:
            dropped = self._track.dropped or ()  # the fingers of all other notes are known
            track = replace(self._variant.of(self._track), dropped=dropped)
            delays = self._variant.release_delays
            self._plan = plan_song(track, self._start, self._context.progress, delays, strikes=True)
        return self._plan

    def _begin_search(self, step: int) -> HandsInScene:
        hands = HandsInScene(self.plan, self._rng, self._context)
        goals = [HandGoals(self.plan, side) for side in self.plan.scene.sides]
        hands.restart(goals, self._tracking, step, self._rng.spawn(len(goals)))
        return hands


class PractisedHands(PlannerPerEnv[PractisedPlanner]):
    """Hands that play the song that was practised."""

    def __init__(
        self, practised: PractisedPlan, config: PlannerConfig, plan: SongPlan | None = None
    ) -> None:
        """Play a practised plan, see `PractisedPlanner`; `config` has the options of its search."""
        super().__init__()
        self._practised, self._config, self._plan = practised, config, plan

    def begin(self, view: View, rng: np.random.Generator) -> PractisedPlanner:
        context = PlanningContext(self._config, Threads(self.threads), self.progress)
        return PractisedPlanner(view, self._practised, rng, context, self._plan)


def _check(practised: PractisedPlan, view: View) -> None:
    """Check that a plan fits the task.

    Raises CadenzaError if another song was practised, or with other hands.
    """
    steps, servos = practised.tracking.ctrl.shape
    check_planned_for(view, steps, servos + 1)
    hands, notes = practised.variant.release_delays.shape[1], len(practised.variant.fingers)
    (track,) = view.tracks
    if (hands, notes) != (sizes := (len(view.task.scene.sides), len(track.score.notes))):
        raise CadenzaError(
            "the plan has {} hands and {} notes, but this task has {} and {}: was another song "
            "practised?".format(hands, notes, *sizes)
        )
