"""Plays a song as it was practised, and what of it has to be kept."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, PlannerPerEnv, Progress, check_planned_for
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan, plan_song
from cadenza.agents.planner.plan.tracking import Follower, Tracking
from cadenza.agents.planner.practice.losses import ONSETS
from cadenza.agents.planner.practice.plan_variants import Variant
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.errors import CadenzaError
from cadenza.sim.threads import Threads
from cadenza.tasks.view import View

_PUSHED = 1e-4  # [m, rad] off the rehearsal; feedback alone leads back from less


class Practised(NamedTuple):
    """All that it takes to play a song as it was practised."""

    tracking: Tracking
    """What the hands do, and the feedback that leads them back to it."""
    way: Variant
    """In which they play it."""


class Rehearsal(NamedTuple):
    """How both hands have played a song of T steps in the whole scene."""

    practised: Practised
    """What they did."""
    f1: float
    note_onset_f1: float

    @property
    def worth(self) -> float:
        """The more, the better, as long as F1 does not fall."""
        return self.f1 + ONSETS * self.note_onset_f1

    def no_worse_than(self, other: Rehearsal) -> bool:
        """Neither in worth nor in F1."""
        return self.worth >= other.worth and self.f1 >= other.f1


class PractisedPlanner:
    """Plays one song as it was practised.

    Feedback leads hands back to where they were in the rehearsal. Once they are pushed too far off
    for that, it searches as the planner does, around what was practised.
    """

    def __init__(
        self,
        view: View,
        practised: Practised,
        config: PlannerConfig,
        rng: np.random.Generator,
        num_threads: int,
        progress: Progress,
        plan: SongPlan | None = None,
    ) -> None:
        """Args:
            view: of the first step, of one environment.
            practised: what is played.
            config: how to search.
            rng: what is random in it.
            num_threads: that share it.
            progress: is told of "postures" when the song is planned.
            plan: if the song has been planned in this way.

        Raises:
            CadenzaError: another song was practised, or with other hands.
        """
        (track,), scene = view.tracks, view.task.scene
        self._tracking, self._way = practised
        _check(practised, view)
        self._follower = Follower(scene, self._tracking)
        self._track, self._start = track, view.state.hand_qpos[0].copy()
        self._pedal = track.goals.sustain
        self._config, self._rng, self._threads = config, rng, Threads(num_threads)
        self._progress, self._plan = progress, plan
        self._searching: HandsInScene | None = None

    def act(self, view: View) -> Array:
        """(A,) the next action."""
        state, step = view.state, int(view.steps[0])
        if not self._searching:
            here = self._follower.posture(state.hand_qpos[0], state.hand_qvel[0])
            off = np.abs(here - self._tracking.expected[step])[:, 0].max()
            if off <= _PUSHED:
                feedback = self._tracking.feedback(step, here)
                ctrl = self._follower.clip(self._tracking.ctrl[step] - feedback)
                return np.append(ctrl, self._pedal[step])
            self._searching = self._searching_from(step)
        return np.append(self._searching.act(state), self._pedal[step])

    @property
    def plan(self) -> SongPlan:
        """Before practice; made when it is first asked for."""
        if self._plan is None:
            dropped = self._track.dropped or ()  # the others have all fingers that they get
            track = replace(self._way.of(self._track), dropped=dropped)
            self._plan = plan_song(track, self._start, self._progress, self._way.later)
        return self._plan

    def _searching_from(self, step: int) -> HandsInScene:
        hands = HandsInScene(self.plan, self._config, self._rng, self._threads)
        parts = [HandGoals(self.plan, side) for side in self.plan.scene.sides]
        hands.follow(self._tracking, parts, step, self._rng.spawn(len(parts)))
        return hands


class PractisedHands(PlannerPerEnv[PractisedPlanner]):
    """Play the song that was practised."""

    def __init__(
        self, practised: Practised, config: PlannerConfig, plan: SongPlan | None = None
    ) -> None:
        """Args:
        practised: what is played.
        config: how to search where hands are pushed off it.
        plan: if the song has been planned in this way.
        """
        super().__init__()
        self._practised, self._config, self._plan = practised, config, plan

    def begin(self, view: View, rng: np.random.Generator) -> PractisedPlanner:
        """Raises:
        CadenzaError: another song was practised, or with other hands.
        """
        return PractisedPlanner(
            view, self._practised, self._config, rng, self.threads, self.progress, self._plan
        )


def _check(practised: Practised, view: View) -> None:
    """Raises: CadenzaError: another song was practised, or with other hands."""
    steps, servos = practised.tracking.ctrl.shape
    check_planned_for(view, steps, servos + 1)
    hands, notes = practised.way.later.shape[1], len(practised.way.fingers)
    (track,) = view.tracks
    if (hands, notes) != (there := (len(view.task.scene.sides), len(track.score.notes))):
        raise CadenzaError(
            "the plan has {} hands and {} notes, but this task has {} and {}: was another song "
            "practised?".format(hands, notes, *there)
        )
