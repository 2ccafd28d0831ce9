"""The notes of a score that hands can play, and the reasons why not the others.

Hands and keyboard have these limits:

- A hand plays at most one note with each finger, at distances that the fingers reach.
- A finger reaches keys from the range of its forearm.
- Forearms must not run into each other.
- A finger stays on its key while the note sounds. Notes with less than `RELEASE_TIME` left when
  others begin count as over.

Notes may be bound to the hands for which they are written. If that hand cannot play one, the other
hand may. If more notes of a chord can be played by any hand, any hand may play them.

If a chord cannot be played as a whole, the outer notes have priority: the highest and the lowest,
then the next from outside, and so on; of two notes equally far inside the louder, then the longer,
then the higher. If a note cannot be played along with those before it in this order, a held note is
released for it, if that is enough: of several, the one that began first. Otherwise, the note is
dropped.

The search follows all sets of fingers that can play the sounding notes, as whole numbers. A set of
fingers that are down is a number of ten bits (two for each finger of a hand), from the left hand's
little finger, 1, to the right hand's, 512. As notes lie in the order of the fingers, the n-th
finger down is on the n-th note. A set of such sets is a number of 1,024 bits, in which bit s stands
for the set s. Each limit is of one note or of a pair, and allows such a set of sets; their
intersection is `&`. To lift finger f lowers s by 2^f, and thus shifts the bits of all s by as many
places.

A note takes 10 to 20 us, and time and memory grow in proportion to the number of notes.
"""

from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.players import Players
from cadenza.fingering.strokes import Stroke, onsets, outer_first
from cadenza.fingers import Finger
from cadenza.music.score import RELEASE_TIME, Score


class Moment(NamedTuple):
    """A moment at which notes begin.

    Attributes:
        time: the time of the moment [s].
        strokes: the keys that are pressed then, in their order.
        num_notes: the number of notes of the score up to then, played or not.
    """

    time: float
    strokes: tuple[Stroke, ...]
    num_notes: int


@dataclass(frozen=True)
class Playable:
    """The notes of a score that can be played.

    Attributes:
        moments: the moments at which notes begin.
        reasons: index of each dropped note -> the reason.
        ignored: index of each note whose given finger contradicts others, or these hands -> finger.
        released: index of each note that is released early for another -> the time [s].
    """

    moments: tuple[Moment, ...]
    reasons: dict[int, str]
    ignored: dict[int, Finger]
    released: dict[int, float]

    def held(self, score: Score) -> Score:
        """The score, with notes that end when they are released."""
        notes = (replace(n, end=self.released.get(i, n.end)) for i, n in enumerate(score.notes))
        return replace(score, notes=tuple(notes))


def playable(score: Score, players: Players, as_written: bool = False) -> Playable:
    """The notes of `score` that these hands can play on this keyboard.

    With `as_written`, each hand plays the notes written for it, if it can.
    """
    moments = []
    reasons: dict[int, str] = {}
    ignored: dict[int, Finger] = {}
    sounding = SoundingNotes(players)
    for time, strokes in onsets(score, players.keyboard.lowest_pitch, as_written):
        for stroke, reason in sounding.advance(time, strokes):
            if stroke.finger is None:
                reasons |= dict.fromkeys(stroke.notes, reason)
            else:
                ignored |= dict.fromkeys(stroke.notes, stroke.finger)
        num_notes = 1 + max(stroke.notes[-1] for stroke in strokes)
        moments.append(Moment(time, tuple(sounding.strokes), num_notes))
    return Playable(tuple(moments), reasons, ignored, sounding.released)


class SoundingNotes:
    """The notes that sound, and all sets of fingers that can play them.

    Attributes:
        strokes: the notes in the order of their keys.
        released: index of each note that was released early for another -> the time [s].
    """

    def __init__(self, players: Players) -> None:
        self.strokes: list[Stroke] = []
        self.released: dict[int, float] = {}
        self._hands = players.description
        self._limits = _limits(players)
        self._sets = _ONLY_EMPTY

    def advance(self, time: float, begin: Sequence[Stroke]) -> list[tuple[Stroke, str]]:
        """Go on to the moment at which others begin; return dropped strokes with their reasons."""
        struck = {stroke.key for stroke in begin}
        for stroke in list(self.strokes):
            if stroke.end <= time + RELEASE_TIME or stroke.key in struck:
                self._release(stroke)
        before = list(self.strokes), self._sets, self.released
        dropped = self._add(begin)
        if dropped and any(stroke.hand is not None for stroke in begin):
            as_written = self.strokes, self._sets, self.released
            self.strokes, self._sets, self.released = before
            by_any_hand = self._add([replace(stroke, hand=None) for stroke in begin])
            if len(by_any_hand) < len(dropped):
                return by_any_hand
            self.strokes, self._sets, self.released = as_written
        return dropped

    def _add(self, begin: Sequence[Stroke]) -> list[tuple[Stroke, str]]:
        """Add playable strokes; return the others with their reasons."""
        dropped = []
        for stroke in outer_first(begin, self.strokes):
            free = replace(stroke, hand=None)
            if not any(map(self._try_to_add, (stroke, free))) and not self._replace_held_by(free):
                dropped.append((stroke, self._reason_to_drop(stroke)))
        return dropped

    def _replace_held_by(self, stroke: Stroke) -> bool:
        """Release a held note, if `stroke` can then be played; return whether it can."""
        held = [other for other in self.strokes if other.start < stroke.start]
        for other in sorted(held, key=attrgetter("start")):
            strokes, sets = list(self.strokes), self._sets
            self._release(other)
            if self._try_to_add(stroke):
                self.released = self.released | dict.fromkeys(other.notes, stroke.start)
                return True
            self.strokes, self._sets = strokes, sets
        return False

    def _release(self, stroke: Stroke) -> None:
        n = self.strokes.index(stroke)
        del self.strokes[n]
        sets = self._sets
        self._sets = 0
        for finger, nth in enumerate(self._limits.nth[n]):
            self._sets |= (sets & nth) >> (1 << finger)

    def _try_to_add(self, stroke: Stroke) -> bool:
        """Add `stroke` if it can be played along with the others; return whether it can."""
        if not 0 <= stroke.key < len(self._limits.reaching):
            return False
        n = bisect(self.strokes, stroke.key, key=attrgetter("key"))
        sets = self._limits.with_finger_on(self._sets, n, stroke)
        allowed, pairs = self._limits.allowed, self._limits.pairs
        for i, below in enumerate(self.strokes[:n]):
            sets &= allowed(i, n, pairs[below.key][stroke.key])
        for i, above in enumerate(self.strokes[n:], start=n + 1):
            sets &= allowed(n, i, pairs[stroke.key][above.key])
        if sets:
            self.strokes.insert(n, stroke)
            self._sets = sets
        return bool(sets)

    def _reason_to_drop(self, stroke: Stroke) -> str:
        """The reason why `stroke` cannot be played along with the others."""
        limits = self._limits
        if not 0 <= stroke.key < len(limits.reaching):
            return "not on this keyboard"
        if not limits.reaching[stroke.key]:
            return f"out of reach of {self._hands}"
        if len(self.strokes) == limits.max_notes:
            return f"more than {limits.max_notes} notes at once for {self._hands}"
        strokes = sorted([*self.strokes, stroke], key=attrgetter("key"))
        sets = _ONLY_EMPTY
        for n, other in enumerate(strokes):
            sets = limits.with_finger_on(sets, n, other, given=other.start == stroke.start)
        for (i, low), (n, high) in combinations(enumerate(strokes), 2):
            sets &= limits.allowed(i, n, limits.pairs_without_forearms[low.key][high.key])
        if sets and all(other.start == stroke.start for other in self.strokes):
            return "the forearms would run into each other"
        others = "what is held by" if sets else "the other notes for"
        return f"too far from {others} {self._hands}"


_ONLY_EMPTY = 1  # the set that holds only the empty set


class _Limits:
    """The limits of hands, as sets of sets of fingers. Fingers are counted from the left.

    Attributes:
        max_notes: maximum number of notes at once.
        nth: [n][f] the sets whose `n`-th finger is f, both from 0.
        reaching: [key] the fingers that reach it.
        pairs: [low][high] the pairs of fingers that reach two keys at once, as bits: with F
            fingers, a on the lower key and b on the higher one are bit F a + b.
        pairs_without_forearms: the same if forearms could pass through each other.
    """

    def __init__(self, players: Players) -> None:
        self.max_notes = players.max_notes
        self._fingers = players.fingers
        self.nth = _nth(len(self._fingers))
        reaches = np.concatenate([players.reaches(1)[:, ::-1], players.reaches(0)], axis=1)
        self.reaching = [np.flatnonzero(row).tolist() for row in reaches]
        self.pairs = _pairs(players)
        self.pairs_without_forearms = _pairs(players, forearms=False)
        self.allowed = cache(self._allowed)

    def with_finger_on(self, sets: int, n: int, stroke: Stroke, given: bool = True) -> int:
        """`sets`, each with one more finger, the `n`-th, which reaches the key of `stroke`.

        With `given`, it has to be the finger, or of the hand, that `stroke` gives, if any.
        """
        fingers = self.reaching[stroke.key]
        if given and stroke.finger is not None:
            fingers = [finger for finger in fingers if self._fingers[finger] == stroke.finger]
        if given and stroke.hand is not None:
            fingers = [finger for finger in fingers if self._fingers[finger].hand == stroke.hand]
        result = 0
        for finger in fingers:
            result |= (sets << (1 << finger)) & self.nth[n][finger]
        return result

    def _allowed(self, i: int, n: int, pairs: int) -> int:
        """All sets whose `i`-th and `n`-th finger are one of `pairs`."""
        count = len(self._fingers)
        sets = 0
        for low, high in combinations(range(count), 2):
            if pairs >> (count * low + high) & 1:
                sets |= self.nth[i][low] & self.nth[n][high]
        return sets


_MAX_PLAYERS = 8  # whose limits are cached; a process rarely has more than two
_limits = lru_cache(_MAX_PLAYERS)(_Limits)


def _nth(count: int) -> list[list[int]]:
    """[n][f] the sets, of `count` fingers, whose `n`-th finger is f."""
    down = (np.arange(1 << count)[:, None] >> np.arange(count) & 1).astype(bool)
    rank = np.where(down, down.cumsum(axis=1) - 1, -1)
    nth = [[_as_number(rank[:, finger] == n) for finger in range(count)] for n in range(count)]
    return [*nth, [0] * count]  # no set has more fingers than there are


def _pairs(players: Players, forearms: bool = True) -> list[list[int]]:
    """[low][high] the pairs of `_Limits.pairs`; `forearms` tells whether forearms matter."""
    one_hand = players.spans()
    num_keys, half = one_hand.shape[1:3]
    right, left = slice(half, None), slice(half - 1, None, -1)  # from the thumbs on
    pairs = np.zeros((num_keys, num_keys, 2 * half, 2 * half), bool)
    pairs[:, :, right, right] = one_hand
    pairs[:, :, left, left] = one_hand.swapaxes(2, 3)
    pairs[:, :, left, right] = True
    if forearms and all(players.forearms):
        lower = players.outermost(1)[:, None, :, None]
        higher = players.outermost(0)[None, :, None, :]
        pairs[:, :, left, right] = ~players.forearms_touch(higher, lower)
    return [[_as_number(bits.ravel()) for bits in row] for row in pairs]


def _as_number(bits: NDArray[np.bool_]) -> int:
    """`bits` (N,) as a whole number, the first as its lowest bit."""
    return int.from_bytes(np.packbits(bits, bitorder="little").tobytes(), "little")
