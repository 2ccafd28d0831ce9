"""Presses: each is a finger that holds a key down, until it or its hand is needed elsewhere."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingers import NO_FINGER, SIDES, Fingers, Side

RISE = 0.05  # time in which a finger rises off a key [s]


class Strike(NamedTuple):
    """The target of a strike: when and how fast its key is to begin to sound."""

    time: float  # the time from the beginning of the control step on [s]
    speed: float  # the angular speed of the key then [rad/s]


class Press(NamedTuple):
    """A finger that holds a key down in the states from `first` up to, not including, `last`.

    State t + 1 follows from step t; state 0 is the start.
    """

    side: Side
    finger: int
    key: int
    first: int
    last: int
    jumps_off: bool = False  # whether the hand leaves the key in a jump
    jumps_to: bool = False  # whether the hand comes to the key in a jump, and to no other key
    from_above: bool = False  # whether the finger comes to the key from above all keys
    # States by which the hand releases keys later than usual before this press
    release_delay: int = 0
    strike: Strike | None = None  # the target of its strike; None if only the step matters

    def delayed(self, states: int) -> Press:
        """This press, a number of states later."""
        return self._replace(first=self.first + states, last=self.last + states)


def presses_of(fingers: NDArray[np.int8], hands: Fingers) -> list[Press]:
    """Presses by time, of the fingers (T, K) that should hold keys down after each step."""
    edges = np.diff(fingers, axis=0, prepend=NO_FINGER, append=NO_FINGER) != 0
    keys_of, states = np.nonzero(edges.T)  # by key, then by time; the last edge of a key is an end
    first, last, key = states[:-1], states[1:], keys_of[:-1]
    rows_of_presses = np.flatnonzero(first < last)
    rows_of_presses = rows_of_presses[
        fingers[first[rows_of_presses], key[rows_of_presses]] != NO_FINGER
    ]
    rows_of_presses = rows_of_presses[np.lexsort((key[rows_of_presses], first[rows_of_presses]))]
    first, last, key = first[rows_of_presses], last[rows_of_presses], key[rows_of_presses]
    rows = np.stack([fingers[first, key], key, first + 1, last + 1], axis=1).tolist()
    return [Press(SIDES[hands.hand_of(finger)], finger, *rest) for finger, *rest in rows]
