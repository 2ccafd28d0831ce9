"""The searches of all hands of a scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.hand_search import HandSearch, SearchState
from cadenza.agents.planner.search.network_candidate import network_candidate
from cadenza.agents.planner.search.networks.weights import shipped
from cadenza.fingers import Side
from cadenza.scene.scene import hand_alone
from cadenza.sim.protocol import State
from cadenza.sim.threads import Threads

Array = NDArray[np.float64]


class HandInScene:
    """The search of one hand, which acts on the state of the whole scene.

    Attributes:
        search: of the hand alone.
        servos: the slice of the scene's servos that are the hand's.
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
        config: how to search.
        rng: what is random.
        threads: that share the rollouts.
        """
        alone, self.servos, self._joints = hand_alone(plan.scene, side)
        self._side = side
        weights = shipped() if config.proposals == "learnt" else {}
        self._weights = weights.get(plan.scene.hand.name)
        self.search = HandSearch(alone, config, plan.track.config.control_timestep, rng, threads)
        self.follow(plan, 0)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Changes the plan, from `step` on, to one that goes further."""
        tracking = plan.nominal.tracking.of(self.servos)
        network = network_candidate(plan, self._side, self._weights, step)
        self.search.follow(HandGoals(plan, self._side), tracking, network)

    def act(self, state: State) -> Array:
        """(A,) the hand's controls, for the first simulation of a `state` of the scene."""
        return self.search.act(*self._joint_state(state))

    def replay(self, state: State, ctrl: Array) -> None:
        """Repeats a step, with the controls (A,) that `act` returned for it."""
        self.search.replay(*self._joint_state(state), ctrl)

    def _joint_state(self, state: State) -> tuple[Array, Array, Array]:
        qpos, qvel = state.hand_qpos[0, self._joints], state.hand_qvel[0, self._joints]
        return qpos, qvel, state.key_qpos[0]


class HandsInScene:
    """The searches of all hands, each with random numbers of its own."""

    def __init__(
        self,
        plan: SongPlan,
        config: PlannerConfig,
        rng: np.random.Generator,
        threads: Threads,
    ) -> None:
        """Args:
        plan: what they follow first.
        config: how to search.
        rng: what is random.
        threads: that share the rollouts.
        """
        sides = plan.scene.sides
        self._threads, self._size = threads, plan.nominal.tracking.ctrl.shape[1]
        self._hands = [
            HandInScene(plan, side, config, hand_rng, threads)
            for side, hand_rng in zip(sides, rng.spawn(len(sides)), strict=True)
        ]

    def act(self, state: State) -> Array:
        """(A,) the controls of all hands, for the first simulation of a `state`."""
        ctrl = np.zeros(self._size)

        def act(i: int) -> None:
            ctrl[self._hands[i].servos] = self._hands[i].act(state)

        self._threads.for_each(range(len(self._hands)), act)
        return ctrl

    def replay(self, state: State, ctrl: Array) -> None:
        """Repeats a step, with the controls (A,) that `act` returned for it."""
        for hand in self._hands:
            hand.replay(state, ctrl[hand.servos])

    @property
    def steps_seen(self) -> int:
        """The number of steps of the plan that a step needs."""
        return max(hand.search.steps_seen for hand in self._hands)

    def follow_plan(self, plan: SongPlan, step: int) -> None:
        """Changes the plan, from `step` on, to one that goes further."""
        for hand in self._hands:
            hand.follow(plan, step)

    @property
    def search_states(self) -> list[SearchState]:
        """The state of each hand's search, see `HandSearch.state`."""
        return [hand.search.state for hand in self._hands]

    def restore(self, states: Sequence[SearchState]) -> None:
        """Goes on as hands that had these `search_states`."""
        for hand, state in zip(self._hands, states, strict=True):
            hand.search.restore(state)

    def follow(
        self,
        tracking: Tracking,
        goals: Sequence[HandGoals],
        step: int,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Follows what was played, from `step` on, and searches where less of it would sound.

        Args:
            tracking: of what was played.
            goals: of each hand, which holds the keys that sounded.
            step: with which to go on.
            rngs: what is random, of each hand.
        """
        for hand, part, rng in zip(self._hands, goals, rngs, strict=True):
            hand.search.follow(part, tracking.of(hand.servos))
            hand.search.reset(step, rng)

    @property
    def simulated(self) -> int:
        """Control steps in rollouts since they began to follow."""
        return sum(hand.search.simulated for hand in self._hands)
