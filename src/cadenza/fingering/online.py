"""The online search for fingers: for notes as they come into sight, of an unknown song.

The limits, costs and dynamic programme are those of the search for a whole song. The finger of a
note may change as others come into sight, until it is settled. The search goes on from the settled
notes, so that its work does not grow with the song.
"""

from copy import copy
from dataclasses import replace
from math import inf

import numpy as np

from cadenza.fingering.playable import SoundingNotes
from cadenza.fingering.players import Players
from cadenza.fingering.search import Stage, backtrack, first_stage, next_stage, state_space
from cadenza.fingering.strokes import Stroke
from cadenza.fingers import Finger
from cadenza.music.score import RELEASE_TIME


class OnlineFingering:
    """Notes that are seen one after the other, numbered as they begin, and fingers for them."""

    def __init__(self, players: Players, moments: int | None = None) -> None:
        """Begin without notes.

        `moments` is the horizon: the number of moments after the settled ones for which fingers are
        found, by default all.
        """
        self._horizon = moments
        self._space, self._num_fingers = state_space(players), players.reach.num_fingers
        self._sounding, self._stage = SoundingNotes(players), first_stage(self._space)
        self._open: list[Stroke] = []  # not settled, by time
        self._stages: list[tuple[float, SoundingNotes, Stage]] = []  # of their first moments
        self._ends: dict[int, float] = {}  # note -> its end, of notes that still matter
        self._num_notes = 0

    def begin(self, key: int, time: float) -> int:
        """Add a note that begins after all others; return its number."""
        number, self._num_notes = self._num_notes, self._num_notes + 1
        self._open.append(Stroke(key, time, inf, 0, None, (number,)))
        self._stages = [stage for stage in self._stages if stage[0] < time]
        self._ends[number] = inf
        return number

    def end(self, number: int, time: float) -> None:
        """Set the end of a note. Notes that were dropped from a chord stay dropped."""
        self._ends[number] = time
        self._stages = [stage for stage in self._stages if stage[0] < time - RELEASE_TIME]

    def find(self, settled: float) -> dict[int, Finger | None]:
        """Unsettled note -> its finger, None if no finger can play it.

        Notes before `settled` [s] and within the horizon are settled from now on.
        """
        moments = self._moments()
        if self._horizon is not None and self._horizon < len(moments):
            settled = min(settled, moments[self._horizon][0])
        for time, strokes in moments[len(self._stages) : self._horizon]:
            self._stages.append((time, *self._next(time, strokes)))
        steps = [stage.backpointers for _, _, stage in self._stages]
        stage = self._stages[-1][-1] if self._stages else self._stage
        fingers, states = backtrack(stage.cost, steps, self._num_fingers)
        numbers = [number for stroke in self._open for number in stroke.notes]
        last = sum(time < settled for time, *_ in self._stages) - 1
        if last >= 0:
            self._settle(last, states[last], settled)
        return {number: fingers.get(number) for number in numbers}

    def _settle(self, last: int, state: tuple[int, int], settled: float) -> None:
        """Settle all notes up to the stage `last`, in which the hands are in `state`."""
        _, self._sounding, stage = self._stages[last]
        self._stages = []  # they hold paths that are now ruled out
        cost = np.full_like(stage.cost, inf)
        cost[state] = stage.cost[state]
        self._stage = replace(stage, cost=cost)
        self._open = [stroke for stroke in self._open if stroke.start >= settled]
        strokes = (*self._sounding.strokes, *self._stage.strokes, *self._open)
        numbers = {number for stroke in strokes for number in stroke.notes}
        self._ends = {number: end for number, end in self._ends.items() if number in numbers}

    def _next(self, time: float, strokes: list[Stroke]) -> tuple[SoundingNotes, Stage]:
        """The sounding notes, and the stage, when `strokes` begin after the last stage."""
        before, stage = self._stages[-1][1:] if self._stages else (self._sounding, self._stage)
        sounding = copy(before)
        sounding.strokes = list(map(self._with_end, before.strokes))
        stage = replace(stage, strokes=tuple(map(self._with_end, stage.strokes)))
        sounding.advance(time, strokes)  # without unplayable notes
        return sounding, next_stage(stage, time, tuple(sounding.strokes), self._space)

    def _moments(self) -> list[tuple[float, list[Stroke]]]:
        """The moments at which unsettled notes begin."""
        moments: dict[float, list[Stroke]] = {}
        for stroke in self._open:
            moments.setdefault(stroke.start, []).append(self._with_end(stroke))
        return list(moments.items())

    def _with_end(self, stroke: Stroke) -> Stroke:
        """`stroke` with the end that is known by now."""
        end = self._ends[stroke.notes[0]]
        return stroke if stroke.end == end else replace(stroke, end=end)
