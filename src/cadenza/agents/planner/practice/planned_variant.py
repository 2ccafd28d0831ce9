"""A song as it is played in one way, and the hands that play and practise it so."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from cadenza.agents.agent import Array, Progress, silent
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.practice.hand_practice import HandPractice
from cadenza.agents.planner.practice.plan_variants import Variant, fingers_in
from cadenza.agents.planner.practice.practised_planner import Practised, Rehearsal
from cadenza.agents.planner.practice.trajectory import Snapshots, Stage, Trajectory, scene_before
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.music.metrics import playing_metrics
from cadenza.sim.threads import Threads
from cadenza.tasks.goal_track import GoalTrack


class PlannedVariant:
    """A song as it is played in one way.

    Attributes:
        way: it is played in.
        plan: of the whole song, before practice.
        parts: of the hands.
        searching: what plays as the planner does.
        stage: where takes are played.
    """

    def __init__(
        self,
        track: GoalTrack,
        start: Array,
        config: PlannerConfig,
        rng: np.random.Generator,
        threads: Threads,
        progress: Progress = silent,
        way: Variant | None = None,
    ) -> None:
        """Args:
            track: the song.
            start: (J,) joint positions of the hands where it begins [m, rad].
            config: how to plan.
            rng: what is random in it.
            threads: that share the work.
            progress: is told of "fingers" and "postures".
            way: to play it in; if not given, with the fingers that it has or that are found.

        Raises:
            CadenzaError: there are no hands in the scene.
        """
        track, later = (way.of(track), way.later) if way else (track, 0)
        plan = self.plan = plan_song(track, start, progress, later)
        never = np.zeros((plan.goals.num_steps, len(plan.scene.sides)), np.int8)
        self.way = way or Variant(fingers_in(plan.track), never)
        self.parts = [HandGoals(plan, side) for side in plan.scene.sides]
        self.searching = HandsInScene(plan, config, rng, threads)
        self._threads = threads
        self.stage = Stage(plan, start, self.parts)

    @cached_property
    def hands(self) -> list[HandPractice]:
        """That practise; most versions are only played once."""
        return [
            HandPractice(self.plan, side, part, self._threads)
            for side, part in zip(self.plan.scene.sides, self.parts, strict=True)
        ]

    @property
    def take_to_come(self) -> Trajectory:
        """Of which nothing has been played."""
        plan = self.plan
        return Trajectory.to_come(
            plan.nominal.tracking, plan.scene.keyboard.num_keys, len(plan.scene.sides)
        )

    def follow(self, take: Trajectory, step: int, rngs: Sequence[np.random.Generator]) -> None:
        """From a step on, its hands follow a take, and search where less of it would sound.

        `rngs` are what is random, of each hand.
        """
        parts = [part.holding(take.sounding) for part in self.parts]
        self.searching.follow(self.stage.tracking(take), parts, step, rngs)

    def rehearsal(self, take: Trajectory) -> Rehearsal:
        """What a take of the whole song is worth, and what leads back to it."""
        scene, track, goals, _ = self.plan
        pedal, lowest = goals.sustain, scene.keyboard.lowest_pitch
        dt, score = track.config.control_timestep, track.on_the_clock
        scores = playing_metrics(take.sounding, pedal, goals.keys, pedal, dt, score, lowest)
        practised = Practised(self.stage.tracking(take), self.way)
        return Rehearsal(practised, scores["f1"], scores["note_onset_f1"])

    def to_the_end(self, take: Trajectory, first: int, moments: Snapshots) -> Trajectory:
        """A take, played anew from the step `first` on, with feedback; `moments` are of before."""
        steps = len(take.ctrl)
        rest, simulation = take.part(first, steps), scene_before(first, take, moments)
        played, _ = self.stage.play(simulation, first, rest, take.heard(first), steps + 1)
        whole = take.part(0, steps)
        whole.put(first, played)
        return whole
