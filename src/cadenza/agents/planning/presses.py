"""Which finger holds which key down when, as far as the hands can be there."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planning.control_steps import steps_in
from cadenza.fingers import NO_FINGER, SIDES, Fingers, Side
from cadenza.hands.hand import Hand

Array = NDArray[np.float64]

RISE = 0.05  # [s] in which a finger gets off a key

_AHEAD = 0.4  # [s] no jump needs more time than this
_FLIGHT = 0.1  # [s] between two presses that is spent on the way, if the hand has to jump
_LEAST = 0.05  # [s] that a press lasts


class Press(NamedTuple):
    """A finger, by its number, holds `key` down in the states `first` up to, not including, `last`.

    State t + 1 follows from step t; state 0 is where the hands start.
    """

    side: Side
    finger: int
    key: int
    first: int
    last: int
    flies_off: bool = False
    """The hand leaves it in a jump."""
    flies_to: bool = False
    """The hand comes to it in a jump, and to no other key."""
    from_above: bool = False
    """The finger comes to it from above all keys."""
    later: int = 0
    """So many states later than usual the hand lets go of what is before it, if it jumps."""


def presses_of(keys: NDArray[np.bool_], fingers: NDArray[np.int8], hands: Fingers) -> list[Press]:
    """The presses that goals ask for, by time.

    Args:
        keys: (T, K) that should be down after each step.
        fingers: (T, K) that should press them; keys without a finger are left alone.
        hands: how fingers are numbered.
    """
    asked = np.where(keys, fingers, NO_FINGER)
    edges = np.diff(asked, axis=0, prepend=NO_FINGER, append=NO_FINGER) != 0
    presses = [
        Press(SIDES[hands.hand_of(finger)], finger, int(key), int(first) + 1, int(last) + 1)
        for key in np.flatnonzero(keys.any(axis=0))
        for first, last in pairwise(np.flatnonzero(edges[:, key]))
        if (finger := int(asked[first, key])) != NO_FINGER
    ]
    return sorted(presses, key=lambda press: (press.first, press.key))


def let_go_in_time(presses: list[Press], places: Array, dt: float, hand: Hand) -> list[Press]:
    """The presses, cut short where finger or hand must be elsewhere soon after, and jumps marked.

    A press keeps `_LEAST`. One that the hand can hold together with all that it strikes is not
    cut.

    Args:
        presses: by time.
        places: (K, F) where a forearm is when one of its fingers presses a key at ease, from where
            it is mounted [m].
        dt: control step [s].
        hand: of either side.
    """
    cut = [press for side in SIDES for press in _let_hand_go(presses, side, places, dt, hand)]
    rise, least = steps_in(RISE, dt), steps_in(_LEAST, dt)
    next_of: dict[int, Press] = {}
    result = []
    for press in sorted(cut, key=lambda press: (press.first, press.key), reverse=True):
        last = press.last
        following = next_of.get(press.finger)
        if following and following.key != press.key:
            last = min(last, max(following.first - rise, press.first + least))
        next_of[press.finger] = press
        result.append(press if last == press.last else press._replace(last=last))
    return _with_jumps(result[::-1], places, steps_in(_FLIGHT, dt), hand.jump_times.within_reach)


def _with_jumps(
    presses: list[Press], places: Array, flight: int, within_reach: float
) -> list[Press]:
    """Marks presses of one hand at most `flight` steps apart and beyond `within_reach` [m]."""
    together = Counter((press.side, press.first) for press in presses)
    firsts = [press.first for press in presses]
    left, reached = set[Press](), set[Press]()
    for press in presses:
        soon, too_late = (bisect_right(firsts, press.last + wait) for wait in (0, flight))
        for later in presses[soon:too_late]:
            way = abs(places[later.key, later.finger] - places[press.key, press.finger])
            if later.side == press.side and way > within_reach:
                left.add(press)
                reached.add(later)
    return [
        press._replace(
            flies_off=press in left,
            flies_to=press in reached and together[press.side, press.first] == 1,
        )
        for press in presses
    ]


def _let_hand_go(
    presses: list[Press], side: Side, places: Array, dt: float, hand: Hand
) -> list[Press]:
    ahead, least, times = steps_in(_AHEAD, dt), steps_in(_LEAST, dt), hand.jump_times
    near = min(times.within_reach, times.while_holding)
    mine = [press for press in presses if press.side == side]
    if not mine:
        return []
    chords = [list(chord) for _, chord in groupby(mine, key=lambda press: press.first)]
    firsts = np.array([chord[0].first for chord in chords])
    sizes = np.array([len(chord) for chord in chords])
    later = np.array([chord[0].later for chord in chords])
    begins = np.cumsum([0, *sizes])
    key, number = np.array([(press.key, press.finger) for press in mine]).T
    finger = number % len(hand.fingers)
    outwards = places[key, 0] * (1 if side == "right" else -1)
    place = places[key, number]
    means = np.array([place[begin:end].sum() for begin, end in pairwise(begins)]) / sizes
    cut = []
    for i, chord in enumerate(chords):
        latest = max(press.last for press in chord)
        end = int(firsts.searchsorted(latest + ahead, "right"))
        if end == i + 1:
            cut += chord
            continue
        first, mean, strikes = firsts[i + 1 : end], means[i + 1 : end], begins[i + 1 : end]
        lasts = np.array([press.last for press in chord])[:, None]
        here, there = slice(begins[i], begins[i + 1]), slice(begins[i + 1], begins[end])
        holding = lasts > first + least  # while the hand plays on
        way = np.abs(mean - np.where(holding, place[here, None], means[i]))
        if way.max() <= near:
            cut += chord
            continue
        seconds = times.seconds(way, len(chord), sizes[i + 1 : end], holding)
        jump = np.ceil(np.round(seconds / dt, 9)).astype(np.intp)
        jump = np.where(jump > 0, np.maximum(jump - later[i + 1 : end], 1), 0)
        spans = hand.reach.spans(
            finger[here, None], finger[there], outwards[there] - outwards[here, None]
        )
        spanned = np.logical_and.reduceat(spans, strikes - begins[i + 1], axis=1)
        too_late = (jump > 0) & ~spanned & (first <= lasts + ahead)
        in_time = np.where(too_late, np.maximum(first - jump, firsts[i] + least), lasts)
        soonest = np.minimum(lasts[:, 0], in_time.min(axis=1)).tolist()
        cut += [p._replace(last=last) for p, last in zip(chord, soonest, strict=True)]
    return cut
