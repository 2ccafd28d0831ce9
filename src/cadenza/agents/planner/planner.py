"""The planner of any score: fingering, inverse kinematics, and search while it plays."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from threading import get_ident
from typing import Protocol, TypeAlias

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv
from cadenza.agents.lateness import EarlyPlanner, early
from cadenza.agents.planner.config import MAX_EFFORT, PlannerConfig
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.song_plan import SongPlan, song_plans
from cadenza.agents.planner.practice.practice import Practice
from cadenza.agents.planner.practice.practised_planner import PractisedPlanner
from cadenza.agents.planner.search.hand_process import HandProcess
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.configs import check_ranges
from cadenza.sim.protocol import State
from cadenza.sim.threads import Threads
from cadenza.tasks.view import View

Player: TypeAlias = "SongPlanner | PractisedPlanner"


class Planner(PlannerPerEnv["Player | EarlyPlanner[Player]"]):
    """An agent that plans a song a window ahead, and refines the plan while it plays.

    With an effort, it plans and practises the whole song before it begins to play. It reports the
    progress of "fingers" and "postures", and with an effort that of the stages of `Practice`.
    """

    def __init__(self, config: PlannerConfig | None = None) -> None:
        """Check the options, and raise a `CadenzaError` if one makes no sense."""
        super().__init__()
        self.config = config or PlannerConfig()
        check_ranges(
            self.config,
            {
                "num_candidates": (4, 10_000),
                "iterations": (1, 10_000),
                "horizon": (0, 60),
                "effort": (0, MAX_EFFORT),
            },
        )
        self.keeps_fingering = self.config.fingering == "score"

    def begin(self, view: View, rng: np.random.Generator) -> Player | EarlyPlanner[Player]:
        return early(view, lambda early_view: self._begin(early_view, rng))

    def _begin(self, view: View, rng: np.random.Generator) -> Player:
        effort, progress = self.config.effort, self.progress
        context = PlanningContext(replace(self.config, effort=0.0), Threads(self.threads), progress)
        if not effort:
            (track,) = view.tracks
            if self.config.fingering == "found":
                track = track.with_found_fingers()
            caller = get_ident()

            def report(stage: str, done: int, total: int) -> None:
                if get_ident() == caller:  # not of plans that another thread makes meanwhile
                    progress(stage, done, total)

            processes = self._processes(len(view.task.scene.sides))
            plans = song_plans(track, view.state.hand_qpos[0], report, strikes=True)
            plans = context.threads.ahead(plans)
            return SongPlanner(plans, lambda plan: [HandsInScene(plan, rng, context, processes)])
        practice = Practice(view, rng, context)

        def goes_on() -> bool:
            progress(*practice.progress(effort))
            return True

        practice.run(effort, goes_on)
        goes_on()
        return PractisedPlanner(view, practice.best().practised, rng, context, practice.plan)

    def _processes(self, hands: int) -> list[HandProcess]:
        """A process for the second hand of the first environment, if there are two threads."""
        if hands < 2 or self.threads < 2 or self.planners or self.config.method == "none":
            return []
        try:
            return [HandProcess()]
        except OSError:  # no memory for it: this process searches for both hands
            return []


class PlanPlayer(Protocol):
    """One hand, or all hands, that play a plan."""

    servos: slice  # the servos of these hands among those of the scene

    @property
    def lookahead(self) -> int:
        """Number of steps of the plan that are needed."""

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""

    def act(self, step: int, state: State) -> Array:
        """Next controls (A,)."""


class SongPlanner(EpisodePlanner):
    """A planner of one song, which plans it a window ahead.

    Attributes:
        plan: the plan so far, before corrections; at the end of the song, all of it.
        hands: the hands that play it, one by one or all together.
    """

    plan: SongPlan

    def __init__(
        self, plans: Iterator[SongPlan], hands_for: Callable[[SongPlan], Sequence[PlanPlayer]]
    ) -> None:
        """Plan the first window; each of the `plans` is longer than the last.

        Raises CadenzaError if there are no hands in the scene.
        """
        self._plans, self.plan = plans, next(plans)
        self.hands = hands_for(self.plan)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        while self.plan.ends_before(step + max(hand.lookahead for hand in self.hands)):
            self.plan = next(self._plans)
            for hand in self.hands:
                hand.follow(self.plan, step)
        action = np.zeros(view.task.action_size)
        action[-1] = self.plan.goals.sustain[step]
        for hand in self.hands:
            action[:-1][hand.servos] = hand.act(step, view.state)
        return action
