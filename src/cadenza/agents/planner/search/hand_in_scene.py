"""One of two hands that refines its part of a plan, in the state of both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.hand_search import HandSearch
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
