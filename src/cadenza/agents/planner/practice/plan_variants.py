"""Variants of a plan where it has a loss, and trajectories that are spliced from the best of them.

A variant has other fingers, found with other costs of the fingering search, or faster jumps: a hand
that releases keys later loses less of their notes, if it still lands in time. Variants are tried
only where the plan has a loss, and kept where they lose less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Mask, steps_in
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.practice.trajectory import Trajectory
from cadenza.fingering.search import find_fingering
from cadenza.fingering.transitions import Costs
from cadenza.fingers import SIDES
from cadenza.tasks.goal_track import GoalTrack, players_of

OTHER_COSTS = (
    Costs(distance=32.0, same_finger=1.0, crossing=3.0),
    Costs(distance=32.0, speed=24.0, crossing=0.5),
    Costs(distance=16.0, crossing=3.0),
)
"""Costs that choose other fingers, one after the other. With all of them, hands move less."""

_BEFORE, _AFTER = 0.2, 0.5  # [s] before and after other fingers whose loss counts, too
_APART = _BEFORE + _AFTER  # minimum time between passages, so that no step counts twice [s]
_JUMP = 0.15  # [s] before a strike at which a jump to it begins
_WINDOW = 1.0  # [s] for which each hand keeps the better of two trajectories with the same fingers

Passage = tuple[slice, slice]  # steps, and the hands whose loss in them counts


class Variant(NamedTuple):
    """A choice of fingers for N notes, and of release times for H hands over T steps."""

    fingers: NDArray[np.int64]  # (N,) the number of each note's finger
    # (T, H) steps by which a hand delays releases before its strikes, see `MotionPlanner`
    release_delays: NDArray[np.int8]

    def equals(self, other: Variant) -> bool:
        """Whether both have the same fingers and release times."""
        same_fingers = np.array_equal(self.fingers, other.fingers)
        return same_fingers and np.array_equal(self.release_delays, other.release_delays)

    def of(self, track: GoalTrack) -> GoalTrack:
        """The track with these fingers."""
        fingers = map(track.scene.fingers.finger, self.fingers.tolist())
        return replace(track, score=track.score.with_fingers(fingers))


class SplicedTrajectory(NamedTuple):
    """The best passages of all trajectories, spliced together."""

    track: GoalTrack  # the song, with any fingers
    variant: Variant  # the fingers and release times of its passages
    trajectory: Trajectory  # the passages, which no hands have played in a row

    def with_fingers_by(self, costs: Costs) -> Variant:
        """The variant with the fingers that these `costs` choose where there is a loss."""
        bare, players = self.track.score.without_fingers(), players_of(self.track.scene)
        as_written = self.track.config.hands_as_written
        fingered, _ = find_fingering(bare, players, costs=costs, as_written=as_written)
        other = self.variant._replace(fingers=fingers_in(replace(self.track, score=fingered)))
        loss = self.trajectory.loss
        return self._merge(other, lambda passage: bool(loss[passage].any()))[0]

    def with_release_delay(self, steps: int) -> Variant:
        """The variant that delays releases by `steps` before jumps with a loss.

        These are the jumps that were delayed by a step less so far.
        """
        delays = self.variant.release_delays.copy()
        for passage in _strikes(self.track, self.variant):
            if self.trajectory.loss[passage].any() and (delays[passage] == steps - 1).all():
                delays[passage] = steps
        return self.variant._replace(release_delays=delays)

    def with_better(
        self, other: Variant, trajectory: Trajectory, goals: Sequence[HandGoals]
    ) -> SplicedTrajectory:
        """Splice in the better passages of a trajectory of another variant.

        Trajectories are compared passage by passage where the variants differ, and second by second
        and hand by hand where the fingers are the same. `goals` are those of the hands in the other
        variant.
        """
        track, best, scene = self.track, self.trajectory, self.track.scene
        variant, passages = self._merge(
            other, lambda passage: bool(trajectory.loss[passage].sum() < best.loss[passage].sum())
        )
        where = np.zeros(trajectory.loss.shape, bool)
        for passage in passages:
            where[passage] = True
        loss = np.where(where, trajectory.loss, best.loss)
        window = steps_in(_WINDOW, track.config.control_timestep)
        refingered = _near_other_fingers(track, self.variant, other)
        where |= better_windows(loss, trajectory.loss, refingered, window)
        servos = [scene.servos_on(side) for side in scene.sides]
        return SplicedTrajectory(track, variant, spliced(best, trajectory, where, goals, servos))

    def _merge(
        self, other: Variant, is_better: Callable[[Passage], bool]
    ) -> tuple[Variant, list[Passage]]:
        """The variant with the better passages of another one, and these passages."""
        passages = list(filter(is_better, passages_of(self.track, self.variant, other)))
        first = _first_steps(self.track)
        variant = Variant(self.variant.fingers.copy(), self.variant.release_delays.copy())
        for passage in passages:
            steps, _ = passage
            notes = (first >= steps.start) & (first < steps.stop)
            variant.fingers[notes] = other.fingers[notes]
            variant.release_delays[passage] = other.release_delays[passage]
        return variant, passages


def passages_of(track: GoalTrack, variant: Variant, other: Variant) -> list[Passage]:
    """The passages in which two variants of a track differ.

    Passages with other fingers are of both hands, as notes may go over to the other hand. Those of
    other release times are of the hand that jumps.
    """
    if (variant.fingers != other.fingers).any():
        return _passages_with_other_fingers(track, variant, other)
    differs = variant.release_delays != other.release_delays
    return [passage for passage in _strikes(track, variant) if differs[passage].any()]


def _passages_with_other_fingers(
    track: GoalTrack, variant: Variant, other: Variant
) -> list[Passage]:
    dt = track.config.control_timestep
    before, after, apart = (steps_in(seconds, dt) for seconds in (_BEFORE, _AFTER, _APART))
    passages: list[Passage] = []
    last = -apart - 1
    for _, first, end in _notes_with_other_fingers(track, variant, other):
        begin = max(first - before, 0) if first > last + apart else passages.pop()[0].start
        last = max(last, end)
        passages.append((slice(begin, last + after), slice(None)))
    return passages


def _near_other_fingers(track: GoalTrack, variant: Variant, other: Variant) -> Mask:
    """(T, H) whether a hand plays with other fingers, or does a little before or after."""
    dt, sides = track.config.control_timestep, [SIDES.index(side) for side in track.scene.sides]
    before, after = steps_in(_BEFORE, dt), steps_in(_AFTER, dt)
    hands = track.scene.fingers.hand_of(np.array([variant.fingers, other.fingers]))  # (2, N)
    near = np.zeros(variant.release_delays.shape, bool)
    for i, first, end in _notes_with_other_fingers(track, variant, other):
        near[max(first - before, 0) : end + after, np.isin(sides, hands[:, i])] = True
    return near


def _notes_with_other_fingers(
    track: GoalTrack, variant: Variant, other: Variant
) -> Iterator[tuple[int, int, int]]:
    """Yield each note with another finger: its index, first step, and the step after its last."""
    for i in np.flatnonzero(variant.fingers != other.fingers).tolist():
        note = track.score.notes[i]
        first = track.first_step(note)
        yield i, first, first + steps_in(note.end - note.start, track.config.control_timestep)


def _strikes(track: GoalTrack, variant: Variant) -> list[Passage]:
    """Passages from before each strike of a hand to before its next one."""
    first, hand = _first_steps(track), track.scene.fingers.hand_of(variant.fingers)
    jump = steps_in(_JUMP, track.config.control_timestep)
    passages: list[Passage] = []
    for column, side in enumerate(track.scene.sides):
        strikes = np.unique(first[hand == SIDES.index(side)])
        begins = [*np.maximum(strikes - jump, 0).tolist(), len(variant.release_delays)]
        passages += [
            (slice(begin, end), slice(column, column + 1)) for begin, end in pairwise(begins)
        ]
    return passages


def _first_steps(track: GoalTrack) -> NDArray[np.intp]:
    """(N,) the step on which each note begins."""
    return np.array([track.first_step(note) for note in track.score.notes], np.intp)


def fingers_in(track: GoalTrack) -> NDArray[np.int64]:
    """(N,) the number of each note's finger."""
    number = track.scene.fingers.number
    return np.array([number(note.finger) for note in track.score.notes], np.int64)


def spliced(
    trajectory: Trajectory,
    other: Trajectory,
    where: Mask,
    goals: Sequence[HandGoals],
    servos: Sequence[slice],
) -> Trajectory:
    """A copy of a trajectory with some steps of each hand from another one.

    Its costs are those of the first trajectory, as they are of all hands together. `where` (T, H)
    are the steps of each hand that come from the other trajectory, with its `goals` there.
    """
    result = trajectory.copied()
    for hand, (hand_goals, hand_servos) in enumerate(zip(goals, servos, strict=True)):
        rows = where[:, hand]
        result.ctrl[rows, hand_servos] = other.ctrl[rows, hand_servos]
        result.expected[rows, hand_servos] = other.expected[rows, hand_servos]
        for name in ("loss", "faults", "strike_loss"):
            getattr(result, name)[rows, hand] = getattr(other, name)[rows, hand]
        keys = hand_goals.keys & rows[:, None]
        for name in ("sounding", "onset", "offset"):
            getattr(result, name)[keys] = getattr(other, name)[keys]
    return result


def better_windows(loss: Array, other: Array, excluded: Mask, window: int) -> Mask:
    """(T, H) the windows, of `window` steps, in which an `other` loss (T, H) of a hand is lower.

    Windows with `excluded` steps (T, H) are left out.
    """
    begins = np.arange(0, len(loss), window)
    sums, other_sums = (np.add.reduceat(values, begins) for values in (loss, other))
    better = (other_sums < sums) & ~np.logical_or.reduceat(excluded, begins)
    return np.repeat(better, window, axis=0)[: len(loss)]
