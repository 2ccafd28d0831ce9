"""Which finger holds which key down when, as far as the hands can be there."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import SIDES, Side, side_of

Array = NDArray[np.float64]

# What a hand needs to jump, measured by having it do so: within `_WITHIN_REACH` the fingers do it;
# further away it glides with `_GLIDE`, lifting itself on the way and striking at its end, except
# that it comes straight down on a chord, which takes a step more.
_WITHIN_REACH = 0.05  # [m]
_REACH_WHILE_HOLDING = 0.06  # [m]
# As if it sped up over half the way and slowed down over the other [m/s^2]; a chord has to land
# on several keys at once.
_GLIDE, _GLIDE_OF_CHORD = 80.0, 50.0
_STEPS_AHEAD = 8  # further away than this, no jump needs the time
_FLIGHT = 2  # steps between two presses that are spent on the way, if the hand has to jump


class Press(NamedTuple):
    """A finger holds `key` down in the states `first` up to, not including, `last`.

    State t + 1 follows from step t; state 0 is where the hands start.
    """

    finger: int
    key: int
    first: int
    last: int
    flies_off: bool = False
    """The hand leaves it in a jump."""
    flies_to: bool = False
    """The hand comes to it in a jump, and to no other key."""

    @property
    def side(self) -> Side:
        """Of the hand."""
        return side_of(self.finger)


def presses_of(keys: NDArray[np.bool_], fingers: NDArray[np.int8]) -> list[Press]:
    """The presses that goals ask for, by time.

    Args:
        keys: (T, 88) that should be down after each step.
        fingers: (T, 88) that should press them; keys without a finger are left alone.
    """
    asked = np.where(keys, fingers, -1)
    edges = np.diff(asked, axis=0, prepend=-1, append=-1) != 0
    presses = [
        Press(int(asked[first, key]), int(key), int(first) + 1, int(last) + 1)
        for key in np.flatnonzero(keys.any(axis=0))
        for first, last in pairwise(np.flatnonzero(edges[:, key]))
        if asked[first, key] >= 0
    ]
    return sorted(presses, key=lambda press: (press.first, press.key))


def let_go_in_time(presses: list[Press], places: Array, dt: float) -> list[Press]:
    """The presses, cut short where finger or hand must be elsewhere soon after, and jumps marked.

    A press keeps a step at least.

    Args:
        presses: by time.
        places: (K, 10) where a forearm is when one of its fingers presses a key at ease, from where
            it is mounted [m].
        dt: control step [s].
    """
    cut = [press for side in SIDES for press in _let_hand_go(presses, side, places, dt)]
    next_of: dict[int, Press] = {}
    result = []
    for press in sorted(cut, key=lambda press: (press.first, press.key), reverse=True):
        last = press.last
        following = next_of.get(press.finger)
        if following and following.key != press.key:
            last = max(min(last, following.first - 1), press.first + 1)
        next_of[press.finger] = press
        result.append(press._replace(last=last))
    return _with_jumps(result[::-1], places)


def _with_jumps(presses: list[Press], places: Array) -> list[Press]:
    """Marks presses of one hand that are as little as `_FLIGHT` apart in time and far in space."""
    together = Counter((press.side, press.first) for press in presses)
    firsts = [press.first for press in presses]
    left, reached = set[Press](), set[Press]()
    for press in presses:
        soon, too_late = (bisect_right(firsts, press.last + steps) for steps in (0, _FLIGHT))
        for later in presses[soon:too_late]:
            way = abs(places[later.key, later.finger] - places[press.key, press.finger])
            if later.side == press.side and way > _WITHIN_REACH:
                left.add(press)
                reached.add(later)
    return [
        press._replace(
            flies_off=press in left,
            flies_to=press in reached and together[press.side, press.first] == 1,
        )
        for press in presses
    ]


def _let_hand_go(presses: list[Press], side: Side, places: Array, dt: float) -> list[Press]:
    mine = [press for press in presses if press.side == side]
    chords = [list(chord) for _, chord in groupby(mine, key=lambda press: press.first)]
    hands = [[float(places[press.key, press.finger]) for press in chord] for chord in chords]
    means = [float(np.mean(hand)) for hand in hands]
    cut = []
    for i, chord in enumerate(chords):
        for press, place in zip(chord, hands[i], strict=True):
            last = press.last
            for j in range(i + 1, len(chords)):
                first = chords[j][0].first
                if first > press.last + _STEPS_AHEAD:
                    break
                if press.last > first + 1:  # held while the hand plays on
                    beyond = abs(means[j] - place) - _REACH_WHILE_HOLDING
                else:
                    beyond = abs(means[j] - means[i]) - _WITHIN_REACH
                if beyond > 0:
                    glide = _GLIDE if len(chord) == len(chords[j]) == 1 else _GLIDE_OF_CHORD
                    steps = int(np.ceil(np.sqrt(4 * beyond / glide) / dt)) + (len(chords[j]) > 1)
                    last = min(last, max(first - steps, press.first + 1))
            cut.append(press._replace(last=last))
    return cut
