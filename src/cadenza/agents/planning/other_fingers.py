"""Other fingers for the passages of a song that lose something.

The search for fingers finds others if something else costs more or less. Of what it finds, only
passages are tried that lose something as they are, and those are kept that lose less.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planning.control_steps import steps_in
from cadenza.fingering.changes import Costs
from cadenza.fingering.search import find_fingering
from cadenza.music.score import Score
from cadenza.tasks.goal_track import GoalTrack, players_of

Array = NDArray[np.float64]

OTHER_COSTS = (
    Costs(way=32.0, same_finger=1.0, crossing=3.0),
    Costs(way=32.0, speed=24.0, crossing=0.5),
    Costs(way=16.0, crossing=3.0),
)
"""What chooses other fingers, one after the other: with all of them, hands move less."""

_BEFORE, _AFTER = 0.2, 0.5  # [s] before and after other fingers by which they are judged
_APART = 0.7  # [s] between passages, so that no step is judged twice


class Passage(NamedTuple):
    """Notes that other fingers play, by their indices, and the steps by which these are judged."""

    notes: list[int]
    steps: slice


class Pieced(NamedTuple):
    """The fingers of a song, of each passage the best that were tried, and what they lost."""

    track: GoalTrack
    loss: Array
    """(T, H) of each step and hand."""

    def others(self, costs: Costs) -> GoalTrack:
        """With the fingers that these `costs` choose where those of before lose something."""
        bare = self.track.score.without_fingers()
        other, _ = find_fingering(bare, players_of(self.track.scene), costs=costs)
        return self._with(other, lambda steps: bool(self.loss[steps].any()))[0]

    def with_better(self, other: Score, loss: Array) -> Pieced:
        """With the passages of `other` that lose less; its `loss` is (T, H)."""
        track, passages = self._with(
            other, lambda steps: bool(loss[steps].sum() < self.loss[steps].sum())
        )
        pieced = self.loss.copy()
        for passage in passages:
            pieced[passage.steps] = loss[passage.steps]
        return Pieced(track, pieced)

    def _with(
        self, other: Score, taken: Callable[[slice], bool]
    ) -> tuple[GoalTrack, list[Passage]]:
        """With the fingers of `other` in the passages that are taken, and these passages."""
        passages = [each for each in passages_of(self.track, other) if taken(each.steps)]
        score = self.track.score
        fingers = [note.finger for note in score.notes]
        for passage in passages:
            for i in passage.notes:
                fingers[i] = other.notes[i].finger
        return replace(self.track, score=score.with_fingers(fingers)), passages


def passages_of(track: GoalTrack, other: Score) -> list[Passage]:
    """In which others play the same notes than in a track, by time."""
    dt = track.config.control_timestep
    before, after, apart = (steps_in(seconds, dt) for seconds in (_BEFORE, _AFTER, _APART))
    passages: list[Passage] = []
    last = -apart
    for i, (note, theirs) in enumerate(zip(track.score.notes, other.notes, strict=True)):
        if note.finger == theirs.finger:
            continue
        first = track.first_step(note)
        if not passages or first > last + apart:
            passages.append(Passage([], slice(max(first - before, 0), 0)))
        last = max(last, first + steps_in(note.end - note.start, dt))
        notes, steps = passages[-1]
        notes.append(i)
        passages[-1] = Passage(notes, slice(steps.start, last + after))
    return passages


def fingers_in(track: GoalTrack) -> NDArray[np.int64]:
    """(N,) who plays each note, as hands number their fingers."""
    number = track.scene.fingers.number
    return np.array([number(note.finger) for note in track.score.notes], np.int64)


def with_fingers(track: GoalTrack, fingers: NDArray[np.int64]) -> GoalTrack:
    """The track with those that `fingers_in` gave (N,)."""
    finger = track.scene.fingers.finger
    return replace(track, score=track.score.with_fingers(map(finger, fingers.tolist())))
