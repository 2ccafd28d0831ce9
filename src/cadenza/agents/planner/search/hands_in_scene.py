"""The searches of all hands of a scene."""

from collections.abc import Sequence

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.hand_search import HandSearch
from cadenza.agents.planner.search.search_ahead import SearchAhead
from cadenza.sim.protocol import State


class HandsInScene:
    """The searches of all hands, each with random numbers of its own.

    They act on the first simulation of states of the whole scene.

    Attributes:
        servos: the hands' servos among all of the scene, which are all.
    """

    servos = slice(None)

    def __init__(self, plan: SongPlan, rng: np.random.Generator, context: PlanningContext) -> None:
        """Follow a plan from its first step on, with the options and threads of `context`."""
        sides = plan.scene.sides
        self._threads, self._size = context.threads, plan.nominal.tracking.ctrl.shape[1]
        self._hands = [
            HandSearch(plan, side, hand_rng, context)
            for side, hand_rng in zip(sides, rng.spawn(len(sides)), strict=True)
        ]
        dt = plan.track.config.control_timestep
        searches = context.config.method != "none"
        self._ahead = [SearchAhead(hand, dt) for hand in self._hands] if searches else []

    def act(self, step: int, state: State) -> Array:
        """Controls (A,) of all hands in the next step."""
        ctrl = np.zeros(self._size)

        def act(i: int) -> None:
            hand = self._hands[i]
            qpos, qvel = state.hand_qpos[0, hand.joints], state.hand_qvel[0, hand.joints]
            here = qpos, qvel, state.key_qpos[0]
            ctrl[hand.servos] = self._ahead[i].act(step, *here) if self._ahead else hand.act(*here)

        self._threads.for_each(range(len(self._hands)), act)
        return ctrl

    @property
    def lookahead(self) -> int:
        """Number of steps of the plan that are needed."""
        return max(each.lookahead for each in self._ahead or self._hands)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a plan that goes further."""
        for hand in self._hands:
            hand.follow(plan, step)

    def restart(
        self,
        goals: Sequence[HandGoals],
        tracking: Tracking,
        step: int,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Follow what was played, from `step` on, and search where less of it would sound.

        The goals of each hand are to hold the keys that sounded. No hand searches ahead any more.
        """
        self._ahead = []
        for hand, part, rng in zip(self._hands, goals, rngs, strict=True):
            hand.restart(part, tracking.of(hand.servos), step, rng)

    @property
    def simulated(self) -> int:
        """Control steps in rollouts since the hands began or were restarted."""
        return sum(hand.simulated for hand in self._hands)
