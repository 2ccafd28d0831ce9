"""The initial trajectories of practice: the planner's, then variants where it has a loss.

In between, the best passages of all trajectories are spliced together, and the hands follow the
result. Practice begins with the best trajectory of all.
"""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np

from cadenza.agents.agent import Array, silent, steps_in
from cadenza.agents.planner.context import PlanningContext
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.agents.planner.practice.hand_practice import HandPractice
from cadenza.agents.planner.practice.plan_variants import (
    OTHER_COSTS,
    SplicedTrajectory,
    Variant,
    fingers_in,
)
from cadenza.agents.planner.practice.practised_planner import PracticeResult, PractisedPlan
from cadenza.agents.planner.practice.trajectory import Snapshots, Trajectory, WholeScene
from cadenza.agents.planner.search.hands_in_scene import HandsInScene
from cadenza.fingering.transitions import Costs
from cadenza.music.metrics import playing_metrics
from cadenza.music.performance import key_events, performed_score
from cadenza.tasks.goal_track import GoalTrack

T = TypeVar("T", Variant, Trajectory)

_CHUNK = 1.0  # [s] that are played at a time
_MAX_DELAY = 0.1  # [s] by which hands delay their releases before a jump
_ANY_VELOCITY = 64  # of notes: only their onsets are compared
_MAX_ROLLOUTS = 4  # of each chunk, with hands that follow a spliced trajectory

Parts = dict[str, dict[str, Any]]  # the arrays of a state by part and name


class _Chunk(NamedTuple):
    played: Trajectory
    snapshots: Snapshots
    simulated: int  # control steps of a hand


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
        """Plan the whole song, from joint positions (J,) of the hands [m, rad].

        By default, the variant has the fingers of the song, or those that are found for it, and the
        usual release times. Raises CadenzaError if there are no hands in the scene.
        """
        track, delays = (variant.of(track), variant.release_delays) if variant else (track, 0)
        plan = self.plan = plan_song(track, start, context.progress, delays, strikes=True)
        usual = np.zeros((plan.goals.num_steps, len(plan.scene.sides)), np.int8)
        self.variant = variant or Variant(fingers_in(plan.track), usual)
        self.goals = [HandGoals(plan, side) for side in plan.scene.sides]
        self.search = HandsInScene(plan, rng, context)
        self.scene = WholeScene(plan, start, self.goals)

    @cached_property
    def hands(self) -> list[HandPractice]:
        """The hands that practise it; most variants are only played once."""
        return [
            HandPractice(self.plan, side, goals)
            for side, goals in zip(self.plan.scene.sides, self.goals, strict=True)
        ]

    def follow(
        self, trajectory: Trajectory, step: int, rngs: Sequence[np.random.Generator]
    ) -> None:
        """Make the hands follow a trajectory from a step on, with a search for its keys."""
        goals = [of_hand.holding(trajectory.sounding) for of_hand in self.goals]
        self.search.restart(goals, self.scene.tracking(trajectory), step, rngs)

    def result(self, trajectory: Trajectory) -> PracticeResult:
        """The scores of a trajectory of the whole song, and the plan that plays it."""
        scene, track, goals = self.plan[:3]
        pedal, lowest = goals.sustain, scene.keyboard.lowest_pitch
        dt, score = track.config.control_timestep, track.delayed_score
        onset, offset = trajectory.onset, trajectory.offset
        events = key_events(onset, offset, np.full_like(onset, _ANY_VELOCITY))
        played = performed_score(trajectory.sounding, pedal, dt, events, lowest)
        scores = playing_metrics(
            trajectory.sounding, pedal, goals.keys, pedal, dt, score, lowest, played
        )
        practised = PractisedPlan(self.scene.tracking(trajectory), self.variant)
        return PracticeResult(practised, scores["f1"], scores["note_onset_f1"])

    def played_to_the_end(
        self, trajectory: Trajectory, first: int, snapshots: Snapshots
    ) -> Trajectory:
        """The trajectory, with the steps from `first` on played anew with feedback."""
        steps, result = len(trajectory.ctrl), trajectory.copied()
        no_snapshots = steps + 1
        played, _ = self.scene.roll_out(trajectory, snapshots, first, steps, no_snapshots)
        result.overwrite(first, played)
        return result


class InitialTrajectories:
    """Trajectories of a song, one after the other.

    Attributes:
        seed: the seed of all randomness from the second trajectory on.
        num_played: the number of steps that have been played of the current trajectory.
    """

    def __init__(
        self, track: GoalTrack, start: Array, rng: np.random.Generator, context: PlanningContext
    ) -> None:
        """Plan the first trajectory of a song, from joint positions (J,) of the hands [m, rad].

        Raises CadenzaError if there are no hands in the scene.
        """
        finds_fingers = context.config.fingering == "found"
        if finds_fingers:
            track = track.with_found_fingers()
        self._start, self._context = start, context._replace(progress=silent)
        self._begin(PlannedVariant(track, start, rng, context))
        self.seed = int(rng.integers(2**63))
        dt = track.config.control_timestep
        self._chunk = steps_in(_CHUNK, dt)
        # Costs that find other fingers; steps by which releases are delayed; None follows the best
        # of all trajectories, spliced together.
        refingers = finds_fingers and track.config.fingering != "human"
        self._schedule: list[Costs | int | None] = [*OTHER_COSTS] if refingers else []
        self._schedule.append(None)
        for delay in range(1, steps_in(_MAX_DELAY, dt) + 1):
            self._schedule += [delay, None]
        self._schedule.append(None)
        self._num_tried = 0
        self._best_before: tuple[PlannedVariant, Trajectory] | None = None
        self._spliced = self._current_as_spliced()

    def _begin(self, planned: PlannedVariant) -> None:
        """Go over to a variant that has not been played yet."""
        self._planned, self._trajectory = planned, Trajectory.unplayed(planned.plan)
        self.num_played = 0
        self._snapshots = {0: planned.scene.at_start()}

    @property
    def best(self) -> tuple[PlannedVariant, Trajectory]:
        """The best trajectory so far; the first one may still have steps that are only planned."""
        return self._best_before or (self._planned, self._trajectory)

    @property
    def is_playing(self) -> bool:
        """Whether the current trajectory has steps left to play."""
        return self.num_played < len(self._trajectory.ctrl)

    @property
    def plays_variant(self) -> bool:
        """Whether another trajectory than the first is being played."""
        return self._best_before is not None

    @property
    def over(self) -> bool:
        """Whether there is nothing left to try."""
        return not self.is_playing and self._num_tried == len(self._schedule)

    def advance(self) -> int:
        """Play a chunk, or begin another trajectory.

        Returns the number of control steps simulated, of all hands.
        """
        if not self.is_playing:
            self._begin_next()
            return 0
        first = self.num_played
        last = min(first + self._chunk, len(self._trajectory.ctrl))
        chunks = self._follow(first, last) if self._follows_spliced else [self._play(first, last)]
        best = min(chunks, key=lambda chunk: float(chunk.played.cost.sum()))
        self._trajectory.overwrite(first, best.played)
        self._snapshots = {step: scene for step, scene in best.snapshots.items() if step == last}
        self.num_played = last  # last of all: after an interrupt, practice can go on
        if not self.is_playing:
            self._compare()
        return sum(chunk.simulated for chunk in chunks)

    def _play(self, first: int, last: int) -> _Chunk:
        search = self._planned.search
        before = search.simulated
        played, snapshots = self._planned.scene.roll_out(
            self._trajectory, self._snapshots, first, last, self._chunk, search.act
        )
        return _Chunk(played, snapshots, search.simulated - before + played.loss.size)

    def _follow(self, first: int, last: int) -> list[_Chunk]:
        """Roll the chunk out again and again, until its loss is that of the spliced trajectory."""
        planned, target, chunks = self._planned, self._spliced.trajectory, list[_Chunk]()
        loss = target.loss[first:last].sum()
        while len(chunks) < _MAX_ROLLOUTS and all(c.played.loss.sum() > loss for c in chunks):
            rng = np.random.default_rng((self.seed, self._num_tried, first, len(chunks)))
            planned.follow(target, first, rng.spawn(len(planned.goals)))
            chunks.append(self._play(first, last))
        return chunks

    def _compare(self) -> None:
        """Splice the finished trajectory, and go on with the best one."""
        if not self._best_before:
            self._spliced = self._current_as_spliced()
            return
        current, (planned, trajectory) = self._planned, self._best_before
        self._spliced = self._spliced.with_better(current.variant, self._trajectory, current.goals)
        if not current.result(self._trajectory).no_worse_than(planned.result(trajectory)):
            self._planned, self._trajectory = planned, trajectory
        self._best_before = None

    def _current_as_spliced(self) -> SplicedTrajectory:
        planned = self._planned
        return SplicedTrajectory(planned.plan.track, planned.variant, self._trajectory.copied())

    def _begin_next(self) -> None:
        """Go over to the next trajectory, unless it would be the best one so far."""
        self._num_tried += 1
        variant = self._next_variant()
        if self._follows_spliced:
            differs = self._spliced.trajectory.loss.sum() < self._trajectory.loss.sum()
        else:
            differs = not variant.equals(self._planned.variant)
        if differs:
            self._best_before = self._planned, self._trajectory
            self._begin(self._plan_variant(variant))

    @property
    def _follows_spliced(self) -> bool:
        return self._num_tried > 0 and self._schedule[self._num_tried - 1] is None

    def _next_variant(self) -> Variant:
        match self._schedule[self._num_tried - 1]:
            case None:
                return self._spliced.variant
            case int(delay):
                return self._spliced.with_release_delay(delay)
            case costs:
                return self._spliced.with_fingers_by(costs)

    def _plan_variant(self, variant: Variant) -> PlannedVariant:
        """Plan a variant, unless it is the current one."""
        if variant.equals(self._planned.variant):
            return self._planned
        rng, track = np.random.default_rng((self.seed, self._num_tried)), self._planned.plan.track
        return PlannedVariant(track, self._start, rng, self._context, variant)

    def result(self) -> PracticeResult:
        """Result of the first trajectory, whose other steps are played as planned."""
        planned = self._planned
        trajectory = planned.played_to_the_end(self._trajectory, self.num_played, self._snapshots)
        return planned.result(trajectory)

    # Saving and restoring

    def parts(self) -> Parts:
        """All arrays of the state beside the best trajectory."""
        planned, _ = self.best
        numbers = {"numbers": [self.num_played, self._num_tried]}
        _, variant, trajectory = self._spliced
        return {
            "initial": numbers | planned.variant._asdict(),
            "spliced": variant._asdict() | trajectory._asdict(),
        }

    def restore(self, parts: Mapping[str, dict[str, Any]], best: Trajectory) -> None:
        """Go on from the `parts` of the same trajectories, of which `best` was the best.

        The current trajectory is played again up to the same step, with the same bits.
        """
        initial, spliced = parts["initial"], parts["spliced"]
        num_played, self._num_tried = initial["numbers"].tolist()
        was_playing = num_played < len(best.ctrl)
        self._spliced = SplicedTrajectory(
            self._spliced.track, _fields(Variant, spliced), _fields(Trajectory, spliced)
        )
        if self._num_tried or not was_playing:
            self._begin(self._plan_variant(_fields(Variant, initial)))
            self._trajectory, self.num_played = best, len(best.ctrl)
            if was_playing:
                self._num_tried -= 1
                self._begin_next()
        while self.num_played < num_played:
            self.advance()


def _fields(kind: type[T], part: Mapping[str, Any]) -> T:
    """A named tuple from a part that holds its fields and others."""
    return kind(**{name: part[name] for name in kind._fields})
