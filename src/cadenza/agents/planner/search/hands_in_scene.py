"""The hands of a song as the planner plays it, or a take from elsewhere than it has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.hand_in_scene import HandInScene
from cadenza.agents.planner.search.memory import SearchState
from cadenza.sim.protocol import State
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]


class HandsInScene:
    """H hands, which search wherever they are about to make mistakes."""

    def __init__(
        self,
        plan: SongPlan,
        config: PlannerConfig,
        rng: np.random.Generator,
        threads: Threads,
    ) -> None:
        """Args:
        plan: of the whole song, which they follow first.
        config: how to search.
        rng: what is random.
        threads: that share the search.
        """
        sides = plan.scene.sides
        self._threads, self._size = threads, plan.nominal.tracking.ctrl.shape[1]
        self._hands = [
            HandInScene(plan, side, config, hand_rng, threads)
            for side, hand_rng in zip(sides, rng.spawn(len(sides)), strict=True)
        ]

    def act(self, state: State) -> Array:
        """(A,) the controls of all, from the first of the states."""
        ctrl = np.zeros(self._size)

        def act(i: int) -> None:
            ctrl[self._hands[i].servos] = self._hands[i].act(state)

        self._threads.for_each(range(len(self._hands)), act)
        return ctrl

    def again(self, state: State, ctrl: Array) -> None:
        """Takes a step with the controls (A,) that `act` returned in that state before."""
        for hand in self._hands:
            hand.again(state, ctrl[hand.servos])

    @property
    def memories(self) -> list[SearchState]:
        """Of each hand."""
        return [hand.refinement.memory for hand in self._hands]

    def remember(self, memories: Sequence[SearchState]) -> None:
        """Goes on as what had those memories would have."""
        for hand, memory in zip(self._hands, memories, strict=True):
            hand.refinement.remember(memory)

    def follow(
        self,
        tracking: Tracking,
        parts: Sequence[HandGoals],
        step: int,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """From a step on, follow what was played, and search where less of it would sound now.

        Args:
            tracking: of what was played.
            parts: what each hand has to do, with the keys that sounded as those that it holds.
            step: with which to go on.
            rngs: what is random, of each hand.
        """
        for hand, part, rng in zip(self._hands, parts, rngs, strict=True):
            hand.refinement.follow(part, tracking.of(hand.servos))
            hand.refinement.start_over(step, rng)

    @property
    def simulated(self) -> int:
        """Control steps in trials since they began to follow."""
        return sum(hand.refinement.simulated for hand in self._hands)
