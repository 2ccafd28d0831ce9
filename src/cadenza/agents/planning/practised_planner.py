"""Plays a song as it was practised."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planning.config import ScorePlannerConfig
from cadenza.agents.planning.hand_part import HandPart
from cadenza.agents.planning.losses import ONSETS
from cadenza.agents.planning.searching import SearchingHands
from cadenza.agents.planning.song_plan import SongPlan
from cadenza.agents.planning.tracking import Follower, Tracking
from cadenza.sim.threads import Threads
from cadenza.tasks.view import View


class Rehearsal(NamedTuple):
    """How both hands have played a song of T steps in the whole scene."""

    tracking: Tracking
    """What they did, and the feedback that leads them back to it."""
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

    From the first step on before which the hands are not where they were in the rehearsal, it
    searches as the planner does, around what was practised.

    Attributes:
        plan: before practice.
    """

    def __init__(
        self,
        plan: SongPlan,
        rehearsal: Rehearsal,
        config: ScorePlannerConfig,
        rng: np.random.Generator,
        num_threads: int,
    ) -> None:
        """Args:
        plan: before practice.
        rehearsal: what is played.
        config: how to search.
        rng: what is random in it.
        num_threads: that share it.
        """
        self.plan, self._tracking = plan, rehearsal.tracking
        self._posture = Follower(plan.scene, rehearsal.tracking).posture
        self._config, self._rng, self._threads = config, rng, Threads(num_threads)
        self._searching: SearchingHands | None = None

    def act(self, view: View) -> Array:
        """(A,) the next action."""
        state, step = view.state, int(view.steps[0])
        ctrl = self._tracking.ctrl[step]
        if not self._searching:
            here = self._posture(state.hand_qpos[0], state.hand_qvel[0])
            if not (here == self._tracking.expected[step]).all():
                self._searching = self._searching_from(step)
        if self._searching:
            ctrl = self._searching.act(state)
        return np.append(ctrl, self.plan.goals.sustain[step])

    def _searching_from(self, step: int) -> SearchingHands:
        hands = SearchingHands(self.plan, self._config, self._rng, self._threads)
        parts = [HandPart(self.plan, side) for side in self.plan.scene.sides]
        hands.follow(self._tracking, parts, step, self._rng.spawn(len(parts)))
        return hands
