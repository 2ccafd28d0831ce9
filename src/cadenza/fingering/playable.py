"""Decides which notes of a score the hands can play, and says why not the others.

The limits:

- as many notes a hand as it has fingers, their distances within what the fingers reach;
- forearms that do not run into each other;
- a finger stays on its key as long as the note sounds; notes with less than `LETTING_GO` left
  when others begin count as over.

Where notes cannot all be played, what sounds already goes on, and of the notes that begin the
outer ones are taken first: the highest and the lowest, then the next from outside, and so on; of
two equally far inside the louder, then the longer, then the higher. A note is dropped if it
cannot be played along with those taken before it.

For this, all ways to play what sounds are followed through the song, as sets of sets in whole
numbers. A set of fingers that are down is a number of ten bits, from the left hand's little
finger, 1, to the right hand's, 512. As notes lie in the order of the fingers, it tells which
finger is on which note: the n-th finger down is on the n-th note. A set of such sets is a number
of 1,024 bits, in which bit s stands for the set s. All limits are between two notes, and each
allows such a set of sets; what all allow is their intersection, `&`. To lift finger f lowers s by
2^f, so that it shifts the bits of all s at once by as many places.

A note takes 10 to 20 us, and time and memory grow in proportion to the number of notes.
"""

from __future__ import annotations

from bisect import bisect
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.presses import Press, onsets, outer_first
from cadenza.fingering.reach import LEAST, MOST, OUTWARD, forearms_touch, is_within
from cadenza.fingers import SIDES, UNKNOWN_FINGER, Side
from cadenza.music.keyboard import KEY_Y
from cadenza.music.score import LETTING_GO, NUM_KEYS, Score

_ORDER = (9, 8, 7, 6, 5, 0, 1, 2, 3, 4)  # the fingers from left to right


class Moment(NamedTuple):
    """A moment at which notes begin.

    Attributes:
        time: [s].
        presses: what is pressed then, in the order of the keys.
        begun: how many notes of the score have begun by then, played or not.
    """

    time: float
    presses: tuple[Press, ...]
    begun: int


@dataclass(frozen=True)
class Playable:
    """What of a score can be played.

    Attributes:
        moments: at which notes begin.
        reasons: why the notes that are not played are not, by their indices.
        unheeded: the given fingers that contradict others, or these hands, by their notes' indices.
    """

    moments: tuple[Moment, ...]
    reasons: dict[int, str]
    unheeded: dict[int, int]


def playable(score: Score, sides: Sequence[Side]) -> Playable:
    """What of `score` can be played by the hands on these `sides`."""
    whose = "both hands" if len(sides) == 2 else f"the {sides[0]} hand"
    moments = []
    reasons: dict[int, str] = {}
    unheeded: dict[int, int] = {}
    sounding = _Sounding([place for place, f in enumerate(_ORDER) if SIDES[f // 5] in sides])
    for time, begin in onsets(score):
        struck = {press.key for press in begin}
        for press in list(sounding.presses):
            if press.end <= time + LETTING_GO or press.key in struck:
                sounding.release(press)
        for press in outer_first(begin, sounding.presses):
            if sounding.take(press):
                continue
            if press.finger == UNKNOWN_FINGER:
                reason = f"{sounding.reason_against(press)} {whose}"
                reasons |= dict.fromkeys(press.notes, reason)
            else:
                unheeded |= dict.fromkeys(press.notes, press.finger)
        moments.append(Moment(time, tuple(sounding.presses), begin[-1].notes[-1] + 1))
    return Playable(tuple(moments), reasons, unheeded)


class _Sounding:
    """What sounds, and all ways to play it.

    Attributes:
        presses: in the order of their keys.
    """

    def __init__(self, fingers: Sequence[int]) -> None:
        """For hands with these `fingers`, 0..9 from left to right."""
        self.presses: list[Press] = []
        self._fingers = fingers
        self._sets = _EMPTY

    def release(self, press: Press) -> None:
        n = self.presses.index(press)
        del self.presses[n]
        sets = self._sets
        self._sets = 0
        for finger in self._fingers:
            self._sets |= (sets & _NTH[n][finger]) >> (1 << finger)

    def take(self, press: Press) -> bool:
        """Adds `press` if it can be played along with the others, and says whether it can."""
        n = bisect(self.presses, press.key, key=attrgetter("key"))
        sets = _with_one_more(self._sets, n, self._fingers) & _given(press, n)
        limits = _limits()
        for i, below in enumerate(self.presses[:n]):
            sets &= _allowed(i, n, limits[below.key][press.key])
        for i, above in enumerate(self.presses[n:], start=n + 1):
            sets &= _allowed(n, i, limits[press.key][above.key])
        if sets:
            self.presses.insert(n, press)
            self._sets = sets
        return bool(sets)

    def reason_against(self, press: Press) -> str:
        """Why `press` cannot be played along with the others by ... (whose hands)."""
        most = len(self._fingers)
        if len(self.presses) == most:
            return f"more than {most} notes at once for"
        presses = sorted([*self.presses, press], key=attrgetter("key"))
        sets = _EMPTY
        for n, other in enumerate(presses):
            sets = _with_one_more(sets, n, self._fingers)
            if other.start == press.start:
                sets &= _given(other, n)
        limits = _limits(forearms=False)
        for (i, low), (n, high) in combinations(enumerate(presses), 2):
            sets &= _allowed(i, n, limits[low.key][high.key])
        return "too far from what is held by" if sets else "too far from the other notes for"


_EMPTY = 1  # only the empty set


def _with_one_more(sets: int, n: int, fingers: Iterable[int]) -> int:
    """`sets`, each with any one of the `fingers` more, which becomes the `n`-th."""
    more = 0
    for finger in fingers:
        more |= (sets << (1 << finger)) & _NTH[n][finger]
    return more


def _given(press: Press, n: int) -> int:
    """The sets in which the `n`-th note has the finger that it is to have, if any."""
    return _ANY if press.finger == UNKNOWN_FINGER else _NTH[n][_ORDER.index(press.finger)]


@cache
def _allowed(i: int, n: int, pairs: int) -> int:
    """The sets whose `i`-th and `n`-th finger are among `pairs`, bits of `_limits`."""
    sets = 0
    for low, high in combinations(range(10), 2):
        if pairs >> (10 * low + high) & 1:
            sets |= _NTH[i][low] & _NTH[n][high]
    return sets


@cache
def _limits(forearms: bool = True) -> list[list[int]]:
    """[low][high]: the pairs of fingers that can be on these two keys.

    Bit 10 a + b stands for the finger a on the lower key and b on the higher, from left to right.

    Args:
        forearms: whether they must not touch.
    """
    distance = (KEY_Y - KEY_Y[:, None])[..., None, None]
    one_hand = is_within(distance, LEAST, MOST)
    right = KEY_Y[:, None] + OUTWARD
    left = -KEY_Y[:, None] + OUTWARD
    apart = ~forearms_touch(right[None, :, None, :], left[:, None, :, None])
    pairs = np.zeros((NUM_KEYS, NUM_KEYS, 10, 10), bool)
    pairs[:, :, 5:, 5:] = one_hand
    pairs[:, :, 4::-1, 4::-1] = one_hand.swapaxes(2, 3)
    pairs[:, :, 4::-1, 5:] = apart | (not forearms)
    return [[_as_number(bits) for bits in row] for row in pairs.reshape(NUM_KEYS, NUM_KEYS, 100)]


def _as_number(bits: NDArray[np.bool_]) -> int:
    return int.from_bytes(np.packbits(bits, bitorder="little").tobytes(), "little")


def _nth() -> list[list[int]]:
    """[n][f]: the sets whose `n`-th finger is f, both from 0."""
    down = (np.arange(1024)[:, None] >> np.arange(10) & 1).astype(bool)
    rank = np.where(down, down.cumsum(axis=1) - 1, -1)
    return [[_as_number(rank[:, finger] == n) for finger in range(10)] for n in range(10)]


_NTH = [*_nth(), [0] * 10]  # no set has eleven
_ANY = (1 << 1024) - 1
