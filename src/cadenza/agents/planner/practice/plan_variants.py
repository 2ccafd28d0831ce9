"""Other ways to play the passages of a song that lose something.

Other fingers: the search for fingers finds others if something else costs more or less. And faster
jumps: a hand that lets go later loses less of what it leaves, if it still lands in time. Other ways
are only tried where something is lost, and kept where they lose less.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.practice.trajectory import Trajectory
from cadenza.fingering.search import find_fingering
from cadenza.fingering.transitions import Costs
from cadenza.fingers import SIDES
from cadenza.tasks.goal_track import GoalTrack, players_of

Mask = NDArray[np.bool_]

OTHER_COSTS = (
    Costs(distance=32.0, same_finger=1.0, crossing=3.0),
    Costs(distance=32.0, speed=24.0, crossing=0.5),
    Costs(distance=16.0, crossing=3.0),
)
"""What chooses other fingers, one after the other: with all of them, hands move less."""

_BEFORE, _AFTER = 0.2, 0.5  # [s] before and after other fingers by which they are judged
_APART = _BEFORE + _AFTER  # [s] between passages, so that no step is judged twice
_JUMP = 0.15  # [s] before a hand strikes in which a jump there begins
_WINDOW = 1.0  # [s] of a hand of which the better of two takes is kept, with the same fingers

Passage = tuple[slice, slice]
"""Steps, and the hands that are judged by them."""


class Variant(NamedTuple):
    """How H hands play N notes over T steps."""

    fingers: NDArray[np.int64]
    """(N,) who plays each note, as hands number their fingers."""
    later: NDArray[np.int8]
    """(T, H) by how many steps later than usual a hand lets go to be in time for what begins."""

    def is_like(self, other: Variant) -> bool:
        """Whether it comes to the same."""
        return np.array_equal(self.fingers, other.fingers) and np.array_equal(
            self.later, other.later
        )

    def of(self, track: GoalTrack) -> GoalTrack:
        """The track with these fingers."""
        fingers = map(track.scene.fingers.finger, self.fingers.tolist())
        return replace(track, score=track.score.with_fingers(fingers))


class SplicedTrajectory(NamedTuple):
    """A song, put together of the best of all takes, and the way in which it is played so."""

    track: GoalTrack
    """The song, with any fingers."""
    way: Variant
    take: Trajectory
    """Which no hands have played like that."""

    def with_fingers_by(self, costs: Costs) -> Variant:
        """With the fingers that these `costs` choose where something is lost."""
        bare = self.track.score.without_fingers()
        found, _ = find_fingering(bare, players_of(self.track.scene), costs=costs)
        other = self.way._replace(fingers=fingers_in(replace(self.track, score=found)))
        way, _ = self._with(other, lambda passage: bool(self.take.loss[passage].any()))
        return way

    def letting_go(self, later: int) -> Variant:
        """So many steps later than usual before jumps, where a step less loses something."""
        changed = self.way.later.copy()
        for passage in _strikes(self.track, self.way):
            if self.take.loss[passage].any() and (changed[passage] == later - 1).all():
                changed[passage] = later
        return self.way._replace(later=changed)

    def with_better(
        self, other: Variant, take: Trajectory, parts: Sequence[HandGoals]
    ) -> SplicedTrajectory:
        """With what loses less in a take in another way, of which `parts` are the hands'.

        It is compared passage by passage where ways differ, and second by second and hand by hand
        where fingers are the same.
        """
        track, kept, scene = self.track, self.take, self.track.scene
        way, passages = self._with(
            other, lambda passage: bool(take.loss[passage].sum() < kept.loss[passage].sum())
        )
        where = np.zeros(take.loss.shape, bool)
        for passage in passages:
            where[passage] = True
        loss = np.where(where, take.loss, kept.loss)
        window = steps_in(_WINDOW, track.config.control_timestep)
        where |= better_windows(loss, take.loss, _unlike(track, way, other), window)
        servos = [scene.servos_on(side) for side in scene.sides]
        return SplicedTrajectory(track, way, patched(kept, take, where, parts, servos))

    def _with(
        self, other: Variant, taken: Callable[[Passage], bool]
    ) -> tuple[Variant, list[Passage]]:
        """With those passages of another way that are taken, and which they are."""
        passages = [each for each in passages_of(self.track, self.way, other) if taken(each)]
        first = _first_steps(self.track)
        way = Variant(self.way.fingers.copy(), self.way.later.copy())
        for passage in passages:
            steps, _ = passage
            notes = (first >= steps.start) & (first < steps.stop)
            way.fingers[notes] = other.fingers[notes]
            way.later[passage] = other.later[passage]
        return way, passages


def passages_of(track: GoalTrack, way: Variant, other: Variant) -> list[Passage]:
    """In which a track is played in different ways.

    Other fingers are judged by both hands, as notes may go over to the other one. Otherwise each
    jump is judged by its hand.
    """
    if (way.fingers != other.fingers).any():
        return _refingered(track, way, other)
    differs = way.later != other.later
    return [passage for passage in _strikes(track, way) if differs[passage].any()]


def _refingered(track: GoalTrack, way: Variant, other: Variant) -> list[Passage]:
    """The passages with other fingers, by time."""
    dt = track.config.control_timestep
    before, after, apart = (steps_in(seconds, dt) for seconds in (_BEFORE, _AFTER, _APART))
    passages: list[Passage] = []
    last = -apart - 1
    for _, first, end in _with_other_fingers(track, way, other):
        begin = max(first - before, 0) if first > last + apart else passages.pop()[0].start
        last = max(last, end)
        passages.append((slice(begin, last + after), slice(None)))
    return passages


def _unlike(track: GoalTrack, way: Variant, other: Variant) -> Mask:
    """(T, H) where each hand plays with other fingers, and a little before and after."""
    dt, sides = track.config.control_timestep, [SIDES.index(side) for side in track.scene.sides]
    before, after = steps_in(_BEFORE, dt), steps_in(_AFTER, dt)
    hands = track.scene.fingers.hand_of(np.array([way.fingers, other.fingers]))  # (2, N)
    unlike = np.zeros(way.later.shape, bool)
    for i, first, end in _with_other_fingers(track, way, other):
        unlike[max(first - before, 0) : end + after, np.isin(sides, hands[:, i])] = True
    return unlike


def _with_other_fingers(
    track: GoalTrack, way: Variant, other: Variant
) -> Iterator[tuple[int, int, int]]:
    """Each note with another finger: its number, its first step and the one after its last."""
    for i in np.flatnonzero(way.fingers != other.fingers).tolist():
        note = track.score.notes[i]
        first = track.first_step(note)
        yield i, first, first + steps_in(note.end - note.start, track.config.control_timestep)


def _strikes(track: GoalTrack, way: Variant) -> list[Passage]:
    """Of each hand, one for each time it strikes: from before that to before the next time."""
    first, hand = _first_steps(track), track.scene.fingers.hand_of(way.fingers)
    jump = steps_in(_JUMP, track.config.control_timestep)
    passages: list[Passage] = []
    for column, side in enumerate(track.scene.sides):
        strikes = np.unique(first[hand == SIDES.index(side)])
        begins = [*np.maximum(strikes - jump, 0).tolist(), len(way.later)]
        passages += [
            (slice(begin, end), slice(column, column + 1)) for begin, end in pairwise(begins)
        ]
    return passages


def _first_steps(track: GoalTrack) -> NDArray[np.intp]:
    """(N,) on which each note begins."""
    return np.array([track.first_step(note) for note in track.score.notes], np.intp)


def fingers_in(track: GoalTrack) -> NDArray[np.int64]:
    """(N,) who plays each note, as hands number their fingers."""
    number = track.scene.fingers.number
    return np.array([number(note.finger) for note in track.score.notes], np.int64)


Array = NDArray[np.float64]


def patched(
    take: Trajectory,
    other: Trajectory,
    where: Mask,
    parts: Sequence[HandGoals],
    servos: Sequence[slice],
) -> Trajectory:
    """A take with some steps of each hand from another take.

    Its costs are those of the first: costs are of all hands at once.

    Args:
        take: T steps.
        other: of the same song.
        where: (T, H) the steps of each hand that come from there.
        parts: of the H hands in the other take.
        servos: which of all are each hand's.
    """
    result = take.part(0, len(take.loss))
    for hand, (part, own) in enumerate(zip(parts, servos, strict=True)):
        rows = where[:, hand]
        result.ctrl[rows, own] = other.ctrl[rows, own]
        result.expected[rows, own] = other.expected[rows, own]
        result.loss[rows, hand] = other.loss[rows, hand]
        keys = part.mine & rows[:, None]
        result.sounding[keys] = other.sounding[keys]
    return result


def better_windows(loss: Array, other: Array, unlike: Mask, window: int) -> Mask:
    """(T, H) the windows of each hand in which another take loses less.

    Args:
        loss: (T, H) of a take.
        other: (T, H) loss of the other one.
        unlike: (T, H) where hands play with other fingers; windows with such a step stay.
        window: in steps.
    """
    begins = np.arange(0, len(loss), window)
    mine, others = (np.add.reduceat(each, begins) for each in (loss, other))
    better = (others < mine) & ~np.logical_or.reduceat(unlike, begins)
    return np.repeat(better, window, axis=0)[: len(loss)]
