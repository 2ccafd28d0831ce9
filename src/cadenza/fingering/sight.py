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
from cadenza.fingering.presses import Press
from cadenza.fingering.search import Ways, beginning, cheapest, chords_of, ways_on
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
        self._open: list[Press] = []  # that are not settled, by time
        self._come: list[tuple[float, Sounding, Ways]] = []  # to their moments, as far as known
        self._ends: dict[int, float] = {}  # note -> when, as far as that is of interest
        self._begun = 0

    def begin(self, key: int, time: float) -> int:
        """A note is seen to begin, after all that were; its number."""
        number, self._begun = self._begun, self._begun + 1
        self._open.append(Press(key, time, inf, 0, None, (number,)))
        self._come = [come for come in self._come if come[0] < time]
        self._ends[number] = inf
        return number

    def end(self, number: int, time: float) -> None:
        """A note is seen to end."""
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
        for time, presses in moments[len(self._come) : self._most]:
            self._come.append((time, *self._on(time, presses)))
        choices = [ways.choice for _, _, ways in self._come]
        ways = self._come[-1][-1] if self._come else self._ways
        fingers, states = cheapest(ways.cost, choices, self._num_fingers)
        numbers = [number for press in self._open for number in press.notes]
        last = sum(time < settled for time, *_ in self._come) - 1
        if last >= 0:
            _, self._sounding, ways = self._come[last]
            self._come = []  # other ways to what comes later are ruled out
            cost = np.full_like(ways.cost, inf)
            cost[states[last]] = ways.cost[states[last]]
            self._ways = replace(ways, cost=cost)
            self._open = [press for press in self._open if press.start >= settled]
            concern = (*self._sounding.presses, *self._ways.presses, *self._open)
            known = {number for press in concern for number in press.notes}
            self._ends = {number: end for number, end in self._ends.items() if number in known}
        return {number: fingers.get(number) for number in numbers}

    def _on(self, time: float, presses: list[Press]) -> tuple[Sounding, Ways]:
        """What sounds, and how hands come to it, when notes begin after all that is known."""
        sounding, ways = self._come[-1][1:] if self._come else (self._sounding, self._ways)
        sounding = self._as_seen(sounding)
        ways = replace(ways, presses=tuple(map(self._ended, ways.presses)))
        for _ in sounding.go_on(time, presses):
            pass  # nobody can play it
        return sounding, ways_on(ways, time, tuple(sounding.presses), self._chords)

    def _moments(self) -> list[tuple[float, list[Press]]]:
        """At which notes begin that are not settled."""
        moments: dict[float, list[Press]] = {}
        for press in self._open:
            moments.setdefault(press.start, []).append(self._ended(press))
        return list(moments.items())

    def _ended(self, press: Press) -> Press:
        """With what is known of its end by now."""
        end = self._ends[press.notes[0]]
        return press if press.end == end else replace(press, end=end)

    def _as_seen(self, sounding: Sounding) -> Sounding:
        seen = copy(sounding)
        seen.presses = list(map(self._ended, sounding.presses))
        return seen
