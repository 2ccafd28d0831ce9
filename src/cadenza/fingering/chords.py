"""What the hands can do about notes that sound together, and what it costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.players import Players, is_within
from cadenza.fingers import Finger
from cadenza.hands.reach import Array, Reach

NEVER = 1e9
"""What is out of the question costs this much."""

_ELSEWHERE = (10.0,)  # [m] where a hand that is not there is
_STRETCH = 1.0
_LEAST_ROOM = 0.001  # [m] of fingers that cannot spread
_CLOSE = 100.0  # [1 / m^2]
_ROOM = 0.031  # [m] from here on the forearms do not mind each other


@dataclass(frozen=True, eq=False)
class Shapes:
    """What a hand of F fingers can do about `m` sounding notes: S sets of fingers on the last.

    The notes lie from the thumb's side to the little finger's; the last row is the empty set.
    Pairs are the P pairs of notes, the first nearer the thumb.

    fingers (S, m)      the finger on each note, or F for none
    one_hot (S, (F + 1) m)  the same
    count (S,)          notes played
    mean (S, m)         weights that give the mean of the notes played
    rest (S,)           the mean of their fingers' offsets from the forearm [m]
    outward (S, m)      how far beyond each note the forearm can be [m]
    leftward, rightward (S,)    how far all its fingers can be off their rest [m]
    least, ease, most (S, P)    of the distances between the notes of each pair [m]
    longer, shorter (S, P)      from ease to most and to least
    played (S, P)       1 for pairs of which both notes are played, else 0
    """

    fingers: NDArray[np.intp]
    one_hot: Array
    count: NDArray[np.intp]
    mean: Array
    rest: Array
    outward: Array
    leftward: Array
    rightward: Array
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    least: Array
    ease: Array
    most: Array
    longer: Array
    shorter: Array
    played: Array


@lru_cache(maxsize=64)
def shapes(m: int, reach: Reach) -> Shapes:
    """What a hand can do about `m` notes."""
    none = reach.num_fingers
    sets = [s for k in range(min(m, none), -1, -1) for s in combinations(range(none), k)]
    fingers = np.array([(none,) * (m - len(s)) + s for s in sets], np.intp)
    fingers = fingers.reshape(len(sets), m)
    played = fingers != none
    count = played.sum(axis=1)
    weights = played / np.maximum(count, 1)[:, None]
    first, second = np.triu_indices(m, 1)
    pair = fingers[:, first], fingers[:, second]
    least = _with_no_finger(reach.least, -10.0)[pair]
    ease = _with_no_finger(reach.rest - reach.rest[:, None], 0.0)[pair]
    most = _with_no_finger(reach.most, 10.0)[pair]
    leftward = _with_no_finger(reach.rest + reach.outward, 10.0)[fingers]
    rightward = _with_no_finger(reach.inward - reach.rest, 10.0)[fingers]
    return Shapes(
        fingers=fingers,
        one_hot=np.eye(none + 1)[fingers].reshape(len(sets), (none + 1) * m),
        count=count,
        mean=weights,
        rest=(weights * _with_no_finger(reach.rest, 0.0)[fingers]).sum(axis=1),
        outward=_with_no_finger(reach.outward, 10.0)[fingers],
        leftward=np.maximum(leftward.min(axis=1, initial=10.0), _LEAST_ROOM),
        rightward=np.maximum(rightward.min(axis=1, initial=10.0), _LEAST_ROOM),
        first=first,
        second=second,
        least=least,
        ease=ease,
        most=most,
        longer=np.maximum(most - ease, _LEAST_ROOM),
        shorter=np.maximum(ease - least, _LEAST_ROOM),
        played=(played[:, first] & played[:, second]).astype(float),
    )


def _with_no_finger(table: Array, value: float) -> Array:
    return np.pad(table, (0, 1), constant_values=value)


@dataclass(frozen=True, eq=False)
class States:
    """S things that one hand can do at a moment: first N in which it plays notes, then others.

    Everything is as if it were the right hand: of the left hand the keyboard is seen mirrored.
    """

    shape: NDArray[np.intp]  # (S,) row of `shapes`
    fingers: NDArray[np.uint8]  # (S, m)
    count: NDArray[np.intp]  # (S,) falls
    playing: int  # N
    free: float  # how far from where it stands it can be without notes as well [m]
    centre: Array  # (S,) where the forearm is when the fingers are as much at rest as can be [m]
    outmost: Array  # (S,) where it can be on the side of the little finger [m]
    cost: Array  # (S,)

    def only(self, those: NDArray[np.bool_]) -> States:
        """Those of them."""
        return States(
            shape=self.shape[those],
            fingers=self.fingers[those],
            count=self.count[those],
            playing=int(np.count_nonzero(self.count[those])),
            free=self.free,
            centre=self.centre[those],
            outmost=self.outmost[those],
            cost=self.cost[those],
        )

    def that_play(self, notes: int) -> slice:
        """The states in which this many notes are played."""
        first, end = np.searchsorted(-self.count, [-notes, 1 - notes]).tolist()
        return slice(first, end)


class Asked(NamedTuple):
    """A note that a hand is asked to begin, with the `finger` if it is known, or to go on with."""

    key: int
    begins: bool
    finger: Finger | None


@dataclass(frozen=True, eq=False)
class Chord:
    """What both hands can do about notes that sound together.

    hands           right, left: R and L states that go with some state of the other
    shared          where they play all notes between them, as blocks of (R, L)
    close (R, L)    what it costs that the forearms are near each other
    """

    hands: tuple[States, States]
    shared: tuple[tuple[slice, slice], ...]
    close: Array


class Chords:
    """What these hands can do about any notes."""

    def __init__(self, players: Players) -> None:
        self._players = players
        self._hands = _Hand(players, 0), _Hand(players, 1)
        self.of = lru_cache(maxsize=512)(self._of)  # chords come again

    @property
    def reach(self) -> Reach:
        """Of both hands."""
        return self._players.reach

    def at_home(self) -> Chord:
        """Without notes, each hand where its forearm is mounted, however close to the other's."""
        right, left = (hand.states((), hand.home) for hand in self._hands)
        return Chord((right, left), ((slice(0, 1), slice(0, 1)),), np.zeros((1, 1)))

    def _of(self, asked: tuple[Asked, ...]) -> Chord:
        """The notes that the hands are `asked` for, from the lowest."""
        hands = self._hands
        right = hands[0].states(asked, hands[0].stands)
        left = hands[1].states(asked[::-1], hands[1].stands)
        close = self._closeness(right, left)
        all_played = right.count[:, None] + left.count == len(asked)
        fits = all_played & (close + right.cost[:, None] + left.cost < NEVER)
        in_right, in_left = fits.any(axis=1), fits.any(axis=0)
        right, left = right.only(in_right), left.only(in_left)
        return Chord(
            hands=(right, left),
            shared=tuple(
                (right.that_play(count), left.that_play(len(asked) - count))
                for count in sorted(set(right.count.tolist()))
            ),
            close=close[np.ix_(in_right, in_left)],
        )

    def _closeness(self, right: States, left: States) -> Array:
        """(R, L) what it costs that the forearms are near each other."""
        at_ease = self.reach.forearm_width + _ROOM
        near = np.maximum(at_ease - (right.centre[:, None] + left.centre), 0.0)
        touch = self._players.forearms_touch(right.outmost[:, None], left.outmost)
        return _CLOSE * near**2 + NEVER * touch


class _Hand:
    """One of the hands, 0 the right, 1 the left.

    Attributes:
        stands: where it can be without notes [m].
        home: where it is before the first.
    """

    def __init__(self, players: Players, hand: int) -> None:
        forearm = players.forearm(hand)
        self.stands = forearm.stands if forearm else _ELSEWHERE
        self.home = (forearm.home,) if forearm else _ELSEWHERE
        self._free = (self.stands[1] - self.stands[0]) / 2 if len(self.stands) > 1 else 0.0
        self._low, self._high = (forearm.low, forearm.high) if forearm else (-10.0, 10.0)
        self._hand, self._reach = hand, players.reach
        self._key_y = players.key_y(hand)
        self._is_black = players.keyboard.is_black
        # (K, F + 1) what a finger that holds a key costs, or none.
        self._holds = np.pad(np.where(players.reaches(hand), 0.0, NEVER), ((0, 0), (0, 1)))

    def states(self, asked: tuple[Asked, ...], stands: tuple[float, ...]) -> States:
        """What it can do about the notes it is `asked` for, from the thumb's side.

        Without notes it is where it `stands` [m].
        """
        y = self._key_y[[note.key for note in asked]]
        can = shapes(len(y), self._reach)
        distance = y[can.second] - y[can.first]
        beyond = distance - can.ease
        room = np.where(beyond > 0, can.longer, can.shorter)
        cost = can.one_hot @ self._wanted(asked).ravel()
        cost += _STRETCH * (can.played * (beyond / room) ** 2).sum(axis=1)
        at_rest = can.mean @ y - can.rest
        centre = np.clip(at_rest, self._low, self._high)
        off = at_rest - centre
        cost += _STRETCH * (off / np.where(off > 0, can.rightward, can.leftward)) ** 2
        able = is_within(distance, can.least, can.most).all(axis=1) & (cost < NEVER)
        able[-1] = False
        cost[-1] = 0.0
        outmost = (y + can.outward).min(axis=1, initial=self._high)
        nothing = np.full(len(stands), len(able) - 1)
        rows = np.concatenate([able.nonzero()[0], nothing])
        return States(
            shape=rows,
            fingers=can.fingers[rows].astype(np.uint8),
            count=can.count[rows],
            playing=len(rows) - len(stands),
            free=self._free,
            centre=np.concatenate([centre[able], stands]),
            outmost=np.concatenate([outmost[able], stands]),
            cost=cost[rows],
        )

    def _wanted(self, asked: Sequence[Asked]) -> Array:
        """(m, F + 1) what each finger on each of the notes costs."""
        wanted = self._holds[[note.key for note in asked]]
        reach, none = self._reach, self._reach.num_fingers
        for row, note in zip(wanted, asked, strict=True):
            if not note.begins:  # paid for
                continue
            on_black = reach.effort_on_black if self._is_black[note.key] else 0.0
            row[:none] += reach.effort + on_black
            if note.finger is not None:
                ours = note.finger.hand == self._hand
                row[np.arange(none + 1) != (note.finger.index if ours else none)] = NEVER
        return wanted
