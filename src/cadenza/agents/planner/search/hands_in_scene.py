"""The searches of all hands of a scene."""

from collections.abc import Sequence

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.tracking import Tracking
from cadenza.agents.planner.search.hand_process import HandProcess
from cadenza.agents.planner.search.hand_search import HandSearch
from cadenza.agents.planner.search.search_ahead import (
    HandState,
    RestartingSearch,
    SearchAhead,
    WindowSearch,
)
from cadenza.scene.scene import hand_alone
from cadenza.sim.protocol import State


class HandsInScene:
    """The searches of all hands, each with random numbers of its own.

    They act on the first simulation of states of the whole scene.

    Attributes:
        servos: the hands' servos among those of the scene: all of them.
        lookahead: the number of steps of the plan that are needed.
    """

    servos = slice(None)

    def __init__(
        self,
        plan: SongPlan,
        rng: np.random.Generator,
        context: PlanningContext,
        processes: Sequence[HandProcess] = (),
    ) -> None:
        """Follow a plan from its first step on, with the options and threads of `context`.

        The `processes` search for the last hands, if they can.
        """
        sides, dt = plan.scene.sides, plan.track.config.control_timestep
        rngs, num_local = rng.spawn(len(sides)), len(sides) - len(processes)
        self._threads, self._size = context.threads, plan.nominal.tracking.ctrl.shape[1]
        remote = zip(processes, sides[num_local:], rngs[num_local:], strict=True)
        for process, side, hand_rng in remote:
            process.search(plan, side, hand_rng, context.config)
        self._hands, local = list[HandSearch](), list[RestartingSearch]()
        windows = list[WindowSearch]()
        process_of_side = [None] * num_local + [*processes]
        for side, hand_rng, hand_process in zip(sides, rngs, process_of_side, strict=True):
            if hand_process is not None and hand_process.is_ready():
                windows.append(hand_process)
            else:
                self._hands.append(HandSearch(plan, side, hand_rng, context.config))
                local.append(RestartingSearch(self._hands[-1], dt))
                windows.append(local[-1])
        self._alone = [hand_alone(plan.scene, side) for side in sides]
        ahead = [SearchAhead(windows[i], plan, self._alone[i], dt) for i in range(len(sides))]
        self._ahead = ahead if context.config.method != "none" else []
        self.lookahead = (local if self._ahead else self._hands)[0].lookahead

    def act(self, step: int, state: State) -> Array:
        """Controls (A,) of all hands in the next step."""
        ctrl = np.zeros(self._size)

        def act(i: int) -> None:
            _, servos, joints = self._alone[i]
            now = state.hand_qpos[0, joints], state.hand_qvel[0, joints], state.key_qpos[0]
            if self._ahead:
                ctrl[servos] = self._ahead[i].act(HandState(step, *now))
            else:
                ctrl[servos] = self._hands[i].act(*now)

        self._threads.for_each(range(len(self._alone)), act)
        return ctrl

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""
        for hand in self._ahead or self._hands:
            hand.follow(plan, step)

    def restart(
        self,
        goals: Sequence[HandGoals],
        tracking: Tracking,
        step: int,
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Follow a trajectory from `step` on, and search where its keys would not sound.

        The goals of each hand are to hold the keys that sounded in it. No hand searches ahead any
        more.
        """
        self._ahead = []
        for hand, hand_goals, rng in zip(self._hands, goals, rngs, strict=True):
            hand.restart(hand_goals, tracking.of(hand.servos), step, rng)

    @property
    def simulated(self) -> int:
        """Number of control steps simulated since the beginning or the last restart."""
        return sum(hand.simulated for hand in self._hands)
