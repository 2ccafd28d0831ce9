"""Presses: each is a finger that holds a key down for some time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Ids, steps_in
from cadenza.fingers import NO_FINGER, SIDES, Fingers, Side
from cadenza.hands.reach import JumpTimes

Key = int | Ids

RISE = 0.05
"""Time in which a finger gets off a key [s]."""


class Strike(NamedTuple):
    """How a key is to begin to sound."""

    time: float
    """When, from the beginning of the control step on [s]."""
    speed: float
    """The angular speed of the key then [rad/s]."""


class Press(NamedTuple):
    """A finger, by its number, holds `key` down in the states `first` up to, not including, `last`.

    State t + 1 follows from step t; state 0 is where the hands start.
    """

    side: Side
    finger: int
    key: int
    first: int
    last: int
    jumps_off: bool = False
    """Whether the hand leaves the key in a jump."""
    jumps_to: bool = False
    """Whether the hand comes to the key in a jump, and to no other key."""
    from_above: bool = False
    """Whether the finger comes to the key from above all keys."""
    release_delay: int = 0
    """States by which the hand delays its releases before this press, compared with the usual."""
    strike: Strike | None = None
    """How the key is to begin to sound, if it matters."""

    def delayed(self, states: int) -> Press:
        """This press, moved later by a number of states."""
        return self._replace(first=self.first + states, last=self.last + states)


def presses_of(fingers: NDArray[np.int8], hands: Fingers) -> list[Press]:
    """The presses, by time, of the fingers (T, K) that should hold keys down after each step.

    They are numbered as those of `hands`, -1 for none.
    """
    edges = np.diff(fingers, axis=0, prepend=NO_FINGER, append=NO_FINGER) != 0
    keys_of, states = np.nonzero(edges.T)  # of a key one after the other, the last one is an end
    first, last, key = states[:-1], states[1:], keys_of[:-1]
    held = np.flatnonzero(first < last)
    held = held[fingers[first[held], key[held]] != NO_FINGER]
    held = held[np.lexsort((key[held], first[held]))]
    first, last, key = first[held], last[held], key[held]
    rows = np.stack([fingers[first, key], key, first + 1, last + 1], axis=1).tolist()
    return [Press(SIDES[hands.hand_of(finger)], finger, *rest) for finger, *rest in rows]


def steps_between(
    key: Key, other: Key, is_black: NDArray[np.bool_], times: JumpTimes, dt: float
) -> Ids:
    """The control steps of `dt` [s] that a finger takes from one key to another, or from N keys.

    `is_black` (K,) says whether keys are black, and `times` how long the hand takes to climb.
    """
    climbs = is_black[other] & ~is_black[key]
    return np.where(climbs, steps_in(times.climb, dt), steps_in(RISE, dt))
