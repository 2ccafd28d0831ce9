"""Release times of presses: early enough for finger or hand to be where they are needed next."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cadenza.agents.agent import Array, Ids, Mask, steps_in
from cadenza.agents.planner.plan.presses import RISE, Press
from cadenza.hands.hand import Hand

_JUMP_TIME = 0.1  # maximum time between two presses between which a hand jumps [s]
_MIN_LENGTH = 0.05  # minimum duration of a press [s]
_FAST_REPEAT = 0.25  # interval of notes of a key, below which they would become too short [s]
_DIGITS = 9  # to which times are rounded, so that whole steps are not rounded up


def release_in_time(
    presses: list[Press], places: Array, is_black: Mask, dt: float, hand: Hand
) -> list[Press]:
    """Cut presses short where finger or hand must be elsewhere soon after, and mark jumps.

    A press lasts at least `_MIN_LENGTH`. It is not cut if the hand can hold it together with the
    next keys.

    Args:
        presses: by time, then by key.
        places: (K, F) positions of a forearm from its mount at which a finger is over a key [m].
        is_black: (K,) whether keys are black.
        dt: control step [s].
        hand: the hand.
    """
    if not presses:
        return []
    line = _TimeLine(presses, places, is_black, dt, hand)
    line.release_for_jumps()
    line.release_for_next_keys()
    result = list(presses)
    for i, last, jumps_off, jumps_to in line.rows():
        result[i] = result[i]._replace(last=last, jumps_off=jumps_off, jumps_to=jumps_to)
    return result


class _TimeLine:
    """P presses by hand, time and key, on a time line on which the left hand plays long after."""

    def __init__(
        self, presses: list[Press], places: Array, is_black: Mask, dt: float, hand: Hand
    ) -> None:
        self._dt, self._is_black = dt, is_black
        self._reach, self._times = hand.reach, hand.jump_times
        widest = self._times.seconds(np.ptp(places), 2, 2)
        self._ahead, self._shortest = self._steps(widest), steps_in(_MIN_LENGTH, dt)
        rows = np.array([(p.finger, p.key, p.first, p.last, p.release_delay) for p in presses])
        is_left = rows[:, 0] >= len(hand.fingers)
        self._index = np.argsort(is_left, kind="stable")
        self._number, self._key, first, last, delay = rows[self._index].T
        is_left = is_left[self._index]
        self._since = is_left * (last.max() + self._ahead + 1)  # where the part of a hand begins
        self._first, self._last = first + self._since, last + self._since
        self._place = places[self._key, self._number]
        self._finger = self._number % len(hand.fingers)
        self._outwards = places[self._key, 0] * np.where(is_left, -1, 1)
        # Chords: one key or more that a hand strikes together.
        self._strikes = np.append(True, self._first[1:] != self._first[:-1])
        self._heads = np.flatnonzero(self._strikes)
        self._chord = np.cumsum(self._strikes) - 1
        self._sizes = np.diff(self._heads, append=len(rows))
        self._begins, self._delay = self._first[self._heads], delay[self._heads]

    def release_for_jumps(self) -> None:
        """Cut presses before chords that the hand does not reach from there."""
        heads, chord, begins, sizes = self._heads, self._chord, self._begins, self._sizes
        until = np.maximum.reduceat(self._last, heads) + self._ahead
        ends = np.append(heads, len(chord))
        after = begins.searchsorted(until, "right")
        press, other = _pairs(ends[chord + 1], ends[after[chord]])
        if not len(press):
            return
        spans = self._reach.spans(
            self._finger[press], self._finger[other], self._outwards[other] - self._outwards[press]
        )
        heads_of_pairs = np.flatnonzero(self._strikes[other])
        spanned = np.logical_and.reduceat(spans, heads_of_pairs)
        press, heads_of_pairs = press[heads_of_pairs], chord[other[heads_of_pairs]]
        here, first, last = chord[press], begins[heads_of_pairs], self._last[press]
        holding = last > first + self._shortest  # while the hand plays on
        means = np.add.reduceat(self._place, heads) / sizes
        distance = np.abs(
            means[heads_of_pairs] - np.where(holding, self._place[press], means[here])
        )
        jump = self._steps(
            self._times.seconds(distance, sizes[here], sizes[heads_of_pairs], holding)
        )
        in_time = np.maximum(
            first - np.maximum(jump - self._delay[heads_of_pairs], 1), begins[here] + self._shortest
        )
        too_late = (jump > 0) & ~spanned & (first <= last + self._ahead)
        np.minimum.at(self._last, press[too_late], in_time[too_late])

    def _steps(self, seconds: Array) -> Ids:
        """Control steps that last `seconds` at least."""
        return np.ceil(np.round(seconds / self._dt, _DIGITS)).astype(np.intp)

    def release_for_next_keys(self) -> None:
        """Cut presses whose finger presses another key next, and those whose key is next again."""
        press, following = self._in_turn(self._number)
        moves = self._key[press] != self._key[following]
        self._release(press[moves], following[moves])
        self._release(*self._in_turn(self._key))

    def _in_turn(self, of: Ids) -> tuple[Ids, Ids]:
        """Presses, and the next press of the same finger or key; `of` (P,) are fingers or keys."""
        order = np.lexsort((self._first, of))
        press, following = order[:-1], order[1:]
        same = of[press] == of[following]
        return press[same], following[same]

    def _release(self, press: Ids, following: Ids) -> None:
        """Cut presses (N,) in time for those that follow."""
        first, begins = self._first[press], self._first[following]
        key, other, chord = self._key[press], self._key[following], self._chord[following]
        is_fast = (key == other) & (begins - first < steps_in(_FAST_REPEAT, self._dt))
        slow = ~is_fast & (self._sizes[chord] > 1) | self._is_black[other] & ~self._is_black[key]
        rise, usual = steps_in(RISE, self._dt), steps_in(self._times.next_key, self._dt)
        needed = np.maximum(np.where(slow, usual - self._delay[chord], rise), rise)
        np.minimum.at(self._last, press, np.maximum(begins - needed, first + self._shortest))

    def rows(self) -> Iterator[tuple[int, int, bool, bool]]:
        """Yield of each press its index, its end, and whether the hand jumps off it, and to it.

        A hand jumps between presses that are at most `_JUMP_TIME` apart and beyond reach. It jumps
        to single keys only.
        """
        first, last, place = self._first, self._last, self._place
        soon = last + steps_in(_JUMP_TIME, self._dt)
        press, other = _pairs(*(first.searchsorted(time, "right") for time in (last, soon)))
        far = np.abs(place[other] - place[press]) > self._times.within_reach
        jumps_off, jumps_to = (np.zeros(len(first), bool) for _ in range(2))
        jumps_off[press[far]], jumps_to[other[far]] = True, True
        jumps_to &= self._sizes[self._chord] == 1
        columns = self._index, last - self._since, jumps_off, jumps_to
        return zip(*(column.tolist() for column in columns), strict=True)


def _pairs(first: Ids, last: Ids) -> tuple[Ids, Ids]:
    """All pairs i and j with first[i] <= j < last[i], (N,) each, by i."""
    counts = last - first
    i = np.repeat(np.arange(len(counts)), counts)
    return i, np.arange(len(i)) + (first - np.cumsum(counts) + counts)[i]
