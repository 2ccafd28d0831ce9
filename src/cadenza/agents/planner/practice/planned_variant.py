"""A variant of a song with its plan, and the hands that play and practise it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.practice.hand_practice import HandPractice
from cadenza.agents.planner.practice.plan_variants import Variant, fingers_in
from cadenza.agents.planner.practice.practised_planner import PracticeResult, PractisedPlan
from cadenza.agents.planner.practice.trajectory import Snapshots, Trajectory, WholeScene
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.music.metrics import playing_metrics
from cadenza.tasks.goal_track import GoalTrack


class PlannedVariant:
    """A variant of a song with its plan.

    Attributes:
        variant: the fingers and the release times.
        plan: the plan of the whole song, before practice.
        goals: the goals of each hand.
        search: the hands that play it as the planner does.
        scene: the scene in which trajectories are rolled out.
    """

    def __init__(
        self,
        track: GoalTrack,
        start: Array,
        rng: np.random.Generator,
        context: PlanningContext,
        variant: Variant | None = None,
    ) -> None:
        """Plans the whole song, from joint positions (J,) of the hands [m, rad].

        By default, the variant has the fingers of the song, or those that are found for it, and the
        usual release times.

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        track, delays = (variant.of(track), variant.release_delays) if variant else (track, 0)
        plan = self.plan = plan_song(track, start, context.progress, delays, strikes=True)
        usual = np.zeros((plan.goals.num_steps, len(plan.scene.sides)), np.int8)
        self.variant = variant or Variant(fingers_in(plan.track), usual)
        self.goals = [HandGoals(plan, side) for side in plan.scene.sides]
        self.search = HandsInScene(plan, rng, context)
        self.scene = WholeScene(plan, start, self.goals)
        self._threads = context.threads

    @cached_property
    def hands(self) -> list[HandPractice]:
        """The hands that practise it; most variants are only played once."""
        return [
            HandPractice(self.plan, side, goals, self._threads)
            for side, goals in zip(self.plan.scene.sides, self.goals, strict=True)
        ]

    def unplayed(self) -> Trajectory:
        """The trajectory as planned, of which nothing has been played."""
        plan = self.plan
        return Trajectory.unplayed(
            plan.nominal.tracking, plan.scene.keyboard.num_keys, len(plan.scene.sides)
        )

    def follow(
        self, trajectory: Trajectory, step: int, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Makes the hands follow a trajectory from a step on, and search where less would sound."""
        goals = [each.holding(trajectory.sounding) for each in self.goals]
        self.search.restart(goals, self.scene.tracking(trajectory), step, rngs)

    def result(self, trajectory: Trajectory) -> PracticeResult:
        """The scores of a trajectory of the whole song, and what it takes to play it."""
        scene, track, goals = self.plan[:3]
        pedal, lowest = goals.sustain, scene.keyboard.lowest_pitch
        dt, score = track.config.control_timestep, track.delayed_score
        scores = playing_metrics(trajectory.sounding, pedal, goals.keys, pedal, dt, score, lowest)
        practised = PractisedPlan(self.scene.tracking(trajectory), self.variant)
        return PracticeResult(practised, scores["f1"], scores["note_onset_f1"])

    def played_to_the_end(
        self, trajectory: Trajectory, first: int, snapshots: Snapshots
    ) -> Trajectory:
        """The trajectory, with the steps from `first` on played anew with feedback."""
        steps, whole = len(trajectory.ctrl), trajectory.copied()
        no_snapshots = steps + 1
        played, _ = self.scene.roll_out(trajectory, snapshots, first, steps, every=no_snapshots)
        whole.overwrite(first, played)
        return whole
