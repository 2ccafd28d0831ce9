"""Plays any score by planning alone: fingering, inverse kinematics, and search while it plays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cadenza.agents.agent import Array, EpisodePlanner, PlannerPerEnv
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.song_plan import SongPlan, song_plans
from cadenza.agents.planner.practice.practice import MOST_EFFORT, Practice
from cadenza.agents.planner.practice.practised_planner import PractisedPlanner
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.configs import check_ranges
from cadenza.sim.threads import Threads
from cadenza.tasks.view import View


class Planner(PlannerPerEnv["SongPlanner | PractisedPlanner"]):
    """Plans a song a window ahead of where it plays, and refines the plan as it goes.

    With an effort, it plans and practises the whole song before it begins to play. It reports the
    progress of "fingers" and "postures", and with an effort of the stages of `Practice`.
    """

    def __init__(self, config: PlannerConfig | None = None) -> None:
        """Checks the options.

        Raises:
            CadenzaError: an option makes no sense.
        """
        super().__init__()
        self.config = config or PlannerConfig()
        check_ranges(
            self.config,
            {
                "num_candidates": (4, 10_000),
                "iterations": (1, 10_000),
                "horizon": (0, 60),
                "effort": (0, MOST_EFFORT),
            },
        )
        self.keeps_fingering = self.config.fingering == "score"

    def begin(self, view: View, rng: np.random.Generator) -> SongPlanner | PractisedPlanner:
        effort, progress = self.config.effort, self.progress
        context = PlanningContext(replace(self.config, effort=0.0), Threads(self.threads), progress)
        if not effort:
            return SongPlanner(view, rng, context)
        practice = Practice(view, rng, context)

        def goes_on() -> bool:
            progress(*practice.progress(effort))
            return True

        practice.run(effort, goes_on)
        goes_on()
        return PractisedPlanner(view, practice.best().practised, rng, context, practice.plan)


class SongPlanner(EpisodePlanner):
    """Plans and plays one song.

    Attributes:
        plan: the plan before refinement, as far as it goes; all of it when the song is over.
    """

    plan: SongPlan

    def __init__(self, view: View, rng: np.random.Generator, context: PlanningContext) -> None:
        """Plans the first window, from the view before the first step of one environment.

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        (track,) = view.tracks
        if context.config.fingering == "found":
            track = track.with_found_fingers()
        self._plans = song_plans(track, view.state.hand_qpos[0], context.progress)
        self.plan = next(self._plans)
        self._hands = HandsInScene(self.plan, rng, context)

    def act(self, view: View) -> Array:
        step = int(view.steps[0])
        while self.plan.ends_before(step + self._hands.lookahead):
            self.plan = next(self._plans)
            self._hands.follow(self.plan, step)
        return np.append(self._hands.act(view.state), self.plan.goals.sustain[step])
