"""Finds fingers for notes as they come in sight, of a song whose rest is not known.

The limits, costs and dynamic programme are those of the search for a whole song. What a note gets
may change as long as others come in sight, until it is settled; what is settled is where the search
goes on from, so that its work does not grow with the song.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from math import inf

import numpy as np

from cadenza.fingering.playable import Sounding
from cadenza.fingering.players import Players
from cadenza.fingering.search import Ways, beginning, cheapest, chords_of, ways_on
from cadenza.fingering.strokes import Stroke
from cadenza.fingers import Finger
from cadenza.music.score import LETTING_GO


class NotesInSight:
    """Notes that are seen one after the other, and the fingers that are found for them.

    They are numbered as they begin.
    """

    def __init__(self, players: Players, moments: int | None = None) -> None:
        """Args:
        players: the hands that are there, and the keyboard.
        moments: at which notes begin that are not settled, for which fingers are found at once.
        """
        self._most = moments
        self._chords, self._num_fingers = chords_of(players), players.reach.num_fingers
        self._sounding, self._ways = Sounding(players), beginning(self._chords)
        self._open: list[Stroke] = []  # that are not settled, by time
        self._come: list[tuple[float, Sounding, Ways]] = []  # to their moments, as far as known
        self._ends: dict[int, float] = {}  # note -> when, as far as that is of interest
        self._begun = 0

    def begin(self, key: int, time: float) -> int:
        """A note is seen to begin, after all that were; its number."""
        number, self._begun = self._begun, self._begun + 1
        self._open.append(Stroke(key, time, inf, 0, None, (number,)))
        self._come = [come for come in self._come if come[0] < time]
        self._ends[number] = inf
        return number

    def end(self, number: int, time: float) -> None:
        """A note is seen to end.

        Which notes are left out of a chord that nobody can play whole stays as it was.
        """
        self._ends[number] = time
        self._come = [come for come in self._come if come[0] < time - LETTING_GO]

    def find(self, settled: float) -> dict[int, Finger | None]:
        """Note -> its finger, of the notes that were not settled; None where none can play it.

        Those that begin before `settled` [s] are settled from now on, as far as fingers have been
        looked for.
        """
        moments = self._moments()
        if self._most is not None and self._most < len(moments):
            settled = min(settled, moments[self._most][0])
        for time, strokes in moments[len(self._come) : self._most]:
            self._come.append((time, *self._on(time, strokes)))
        choices = [ways.choice for _, _, ways in self._come]
        ways = self._come[-1][-1] if self._come else self._ways
        fingers, states = cheapest(ways.cost, choices, self._num_fingers)
        numbers = [number for stroke in self._open for number in stroke.notes]
        last = sum(time < settled for time, *_ in self._come) - 1
        if last >= 0:
            _, self._sounding, ways = self._come[last]
            self._come = []  # other ways to what comes later are ruled out
            cost = np.full_like(ways.cost, inf)
            cost[states[last]] = ways.cost[states[last]]
            self._ways = replace(ways, cost=cost)
            self._open = [stroke for stroke in self._open if stroke.start >= settled]
            concern = (*self._sounding.strokes, *self._ways.strokes, *self._open)
            known = {number for stroke in concern for number in stroke.notes}
            self._ends = {number: end for number, end in self._ends.items() if number in known}
        return {number: fingers.get(number) for number in numbers}

    def _on(self, time: float, strokes: list[Stroke]) -> tuple[Sounding, Ways]:
        """What sounds, and how hands come to it, when notes begin after all that is known."""
        sounding, ways = self._come[-1][1:] if self._come else (self._sounding, self._ways)
        sounding = self._as_seen(sounding)
        ways = replace(ways, strokes=tuple(map(self._ended, ways.strokes)))
        for _ in sounding.go_on(time, strokes):
            pass  # nobody can play it
        return sounding, ways_on(ways, time, tuple(sounding.strokes), self._chords)

    def _moments(self) -> list[tuple[float, list[Stroke]]]:
        """At which notes begin that are not settled."""
        moments: dict[float, list[Stroke]] = {}
        for stroke in self._open:
            moments.setdefault(stroke.start, []).append(self._ended(stroke))
        return list(moments.items())

    def _ended(self, stroke: Stroke) -> Stroke:
        """With what is known of its end by now."""
        end = self._ends[stroke.notes[0]]
        return stroke if stroke.end == end else replace(stroke, end=end)

    def _as_seen(self, sounding: Sounding) -> Sounding:
        seen = copy(sounding)
        seen.strokes = list(map(self._ended, sounding.strokes))
        return seen
