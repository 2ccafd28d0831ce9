"""The search of one hand in the state of the whole scene, and the searches of all hands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.hand_search import HandSearch, SearchState
from cadenza.agents.planner.search.network_candidate import proposal
from cadenza.agents.planner.search.networks.weights import shipped
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.sim.protocol import State
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]


class HandInScene:
    """A hand that refines its part of a plan, and where it stands among both.

    Attributes:
        refinement: what the hand does.
        servos: which of both hands' are its own.
    """

    def __init__(
        self,
        plan: SongPlan,
        side: Side,
        config: PlannerConfig,
        rng: np.random.Generator,
        threads: Threads,
    ) -> None:
        """Args:
        plan: what it follows first.
        side: of the hand.
        config: how to refine it.
        rng: what is random.
        threads: that share the search.
        """
        alone, self.servos, self._joints = hand_alone(plan.scene, side)
        self._side = side
        known = shipped() if config.proposals == "learnt" else {}
        self._weights = known.get(plan.scene.hand.name)
        dt = plan.track.config.control_timestep
        self.refinement = HandSearch(alone, config, dt, rng, threads)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """From that step on, by a plan that goes further than the one before."""
        proposed = proposal(plan, self._side, self._weights, step)
        tracking = plan.nominal.tracking.of(self.servos)
        self.refinement.follow(HandGoals(plan, self._side), tracking, proposed)

    def act(self, state: State) -> Array:
        """(A,) its controls, from the first of the states of both hands."""
        return self.refinement.act(*self._here(state))

    def again(self, state: State, ctrl: Array) -> None:
        """Takes a step with its controls (A,) that `act` returned in that state before."""
        self.refinement.again(*self._here(state), ctrl)

    def _here(self, state: State) -> tuple[Array, Array, Array]:
        qpos, qvel = state.hand_qpos[0, self._joints], state.hand_qvel[0, self._joints]
        return qpos, qvel, state.key_qpos[0]


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
