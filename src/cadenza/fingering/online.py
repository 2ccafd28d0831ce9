"""The search for fingers online: for notes as they come in sight, of a song that is not known yet.

The limits, costs and dynamic programme are those of the search for a whole song. The finger of a
note may change as others come in sight, until it is settled. The search goes on from what is
settled, so that its work does not grow with the song.
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

        `moments` is the horizon: the number of moments ahead of what is settled for which fingers
        are found; by default all.
        """
        self._horizon = moments
        self._space, self._num_fingers = state_space(players), players.reach.num_fingers
        self._sounding, self._stage = SoundingNotes(players), first_stage(self._space)
        self._open: list[Stroke] = []  # that are not settled, by time
        self._stages: list[tuple[float, SoundingNotes, Stage]] = []  # of their moments, if known
        self._ends: dict[int, float] = {}  # note -> its end, as long as it matters
        self._begun = 0

    def begin(self, key: int, time: float) -> int:
        """Add a note that begins after all others; return its number."""
        number, self._begun = self._begun, self._begun + 1
        self._open.append(Stroke(key, time, inf, 0, None, (number,)))
        self._stages = [stage for stage in self._stages if stage[0] < time]
        self._ends[number] = inf
        return number

    def end(self, number: int, time: float) -> None:
        """Set the end of a note. Notes that were dropped from a chord stay dropped."""
        self._ends[number] = time
        self._stages = [stage for stage in self._stages if stage[0] < time - RELEASE_TIME]

    def find(self, settled: float) -> dict[int, Finger | None]:
        """Note -> its finger, of the notes that were not settled; None where none can play it.

        Those that begin before `settled` [s] are settled from now on, if they are within the
        horizon.
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
        """Go on from the stage `last`, in which the hands are in `state`, from now on."""
        _, self._sounding, stage = self._stages[last]
        self._stages = []  # they hold other paths, which are ruled out now
        cost = np.full_like(stage.cost, inf)
        cost[state] = stage.cost[state]
        self._stage = replace(stage, cost=cost)
        self._open = [stroke for stroke in self._open if stroke.start >= settled]
        strokes = (*self._sounding.strokes, *self._stage.strokes, *self._open)
        known = {number for stroke in strokes for number in stroke.notes}
        self._ends = {number: end for number, end in self._ends.items() if number in known}

    def _next(self, time: float, strokes: list[Stroke]) -> tuple[SoundingNotes, Stage]:
        """The sounding notes, and the stage, when `strokes` begin after all that is known."""
        before, stage = self._stages[-1][1:] if self._stages else (self._sounding, self._stage)
        sounding = copy(before)
        sounding.strokes = list(map(self._with_end, before.strokes))
        stage = replace(stage, strokes=tuple(map(self._with_end, stage.strokes)))
        sounding.advance(time, strokes)  # without what nobody can play
        return sounding, next_stage(stage, time, tuple(sounding.strokes), self._space)

    def _moments(self) -> list[tuple[float, list[Stroke]]]:
        """The moments at which notes begin that are not settled."""
        moments: dict[float, list[Stroke]] = {}
        for stroke in self._open:
            moments.setdefault(stroke.start, []).append(self._with_end(stroke))
        return list(moments.items())

    def _with_end(self, stroke: Stroke) -> Stroke:
        """`stroke` with its end as far as it is known by now."""
        end = self._ends[stroke.notes[0]]
        return stroke if stroke.end == end else replace(stroke, end=end)
