"""States of the search for fingers: the ways in which hands can play a chord.

Both hands are described as right hands: for the left one, the keyboard is mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.players import Players, is_within
from cadenza.fingers import Finger
from cadenza.hands.reach import Array, Reach

INFEASIBLE = 1e9  # cost of an impossible state or transition, above all costs of a song together

_FAR = 10.0  # [m] farther than anything at a keyboard
_STRETCH = 1.0  # cost of fingers that are stretched or squeezed to their limits
_MIN_ROOM = 0.001  # [m] of fingers that cannot spread, to avoid division by zero
_FOREARMS_NEAR = 100.0  # [1 / m^2] cost of forearms near each other
_FOREARM_ROOM = 0.031  # [m] gap between forearms above which it costs nothing


@dataclass(frozen=True, eq=False)
class FingerSets:
    """The S sets of fingers with which a hand of F fingers can play the last of `m` notes.

    The notes are in order from the thumb to the little finger; the last row is the empty set. There
    are P pairs of notes, whose first note is nearer the thumb.

    fingers (S, m)          the finger on each note, or F for none
    one_hot (S, m (F + 1))  the same
    count (S,)              number of notes played
    mean (S, m)             weights that give the mean of the notes played
    rest (S,)               the mean of their fingers' offsets from the forearm [m]
    outward (S, m)          maximum offset of the forearm outwards from each note [m]
    leftward, rightward (S,)    maximum offsets of all fingers from rest [m]
    first, second (P,)      the notes of each pair
    least, ease, most (S, P)    distances between the notes of each pair [m]
    longer, shorter (S, P)  from ease to most and to least [m]
    played (S, P)           1 for pairs whose notes are both played, else 0
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
def finger_sets(m: int, reach: Reach) -> FingerSets:
    """The sets of fingers with which a hand can play `m` notes, or some of them."""
    none = reach.num_fingers
    sets = [s for k in range(min(m, none), -1, -1) for s in combinations(range(none), k)]
    fingers = np.array([(none,) * (m - len(s)) + s for s in sets], np.intp)
    fingers = fingers.reshape(len(sets), m)
    played = fingers != none
    count = played.sum(axis=1)
    weights = played / np.maximum(count, 1)[:, None]
    first, second = np.triu_indices(m, 1)
    pair = fingers[:, first], fingers[:, second]
    least = _with_no_finger(reach.least, -_FAR)[pair]
    ease = _with_no_finger(reach.rest - reach.rest[:, None], 0.0)[pair]
    most = _with_no_finger(reach.most, _FAR)[pair]
    leftward = _with_no_finger(reach.rest + reach.outward, _FAR)[fingers]
    rightward = _with_no_finger(reach.inward - reach.rest, _FAR)[fingers]
    return FingerSets(
        fingers=fingers,
        one_hot=np.eye(none + 1)[fingers].reshape(len(sets), (none + 1) * m),
        count=count,
        mean=weights,
        rest=(weights * _with_no_finger(reach.rest, 0.0)[fingers]).sum(axis=1),
        outward=_with_no_finger(reach.outward, _FAR)[fingers],
        leftward=np.maximum(leftward.min(axis=1, initial=_FAR), _MIN_ROOM),
        rightward=np.maximum(rightward.min(axis=1, initial=_FAR), _MIN_ROOM),
        first=first,
        second=second,
        least=least,
        ease=ease,
        most=most,
        longer=np.maximum(most - ease, _MIN_ROOM),
        shorter=np.maximum(ease - least, _MIN_ROOM),
        played=(played[:, first] & played[:, second]).astype(float),
    )


def _with_no_finger(table: Array, value: float) -> Array:
    """`table` with one more row, and column, for no finger."""
    return np.pad(table, (0, 1), constant_values=value)


@dataclass(frozen=True, eq=False)
class HandStates:
    """S states of one hand at a moment: the first N play notes, the others are idle."""

    finger_set: NDArray[np.intp]  # (S,) rows of `finger_sets`
    fingers: NDArray[np.uint8]  # (S, m)
    count: NDArray[np.intp]  # (S,) notes played, in falling order
    playing: int  # N
    idle_slack: float  # half the distance between places of an idle hand [m]
    centre: Array  # (S,) place of the forearm with the fingers nearest to rest [m]
    outmost: Array  # (S,) outmost place of the forearm, towards the little finger [m]
    cost: Array  # (S,)

    def subset(self, mask: NDArray[np.bool_]) -> HandStates:
        """The states for which `mask` (S,) holds."""
        names = "finger_set", "fingers", "count", "centre", "outmost", "cost"
        arrays = {name: getattr(self, name)[mask] for name in names}
        return replace(self, playing=int(np.count_nonzero(arrays["count"])), **arrays)

    def with_count(self, notes: int) -> slice:
        """The states in which `notes` notes are played."""
        first, end = np.searchsorted(-self.count, [-notes, 1 - notes]).tolist()
        return slice(first, end)


class ChordNote(NamedTuple):
    """A note that a hand has to begin, or to hold on, with its given `finger` or `hand`, if any."""

    key: int
    begins: bool
    finger: Finger | None = None
    hand: int | None = None


@dataclass(frozen=True, eq=False)
class ChordStates:
    """The states of both hands for notes that sound together.

    hands           right, left: R and L states, each feasible with some state of the other hand
    splits          blocks of (R, L) in which the hands share all notes between them
    forearms (R, L) cost of forearms near each other
    """

    hands: tuple[HandStates, HandStates]
    splits: tuple[tuple[slice, slice], ...]
    forearms: Array


class StateSpace:
    """The states of these hands for any notes."""

    def __init__(self, players: Players) -> None:
        self._players = players
        self._hands = _HandSpace(players, 0), _HandSpace(players, 1)
        self.of = lru_cache(maxsize=512)(self._of)  # chords recur

    @property
    def reach(self) -> Reach:
        """The reach of either hand."""
        return self._players.reach

    def initial(self) -> ChordStates:
        """The states without notes: each hand where its forearm is mounted."""
        right, left = (hand.states((), hand.home) for hand in self._hands)
        return ChordStates((right, left), ((slice(0, 1), slice(0, 1)),), np.zeros((1, 1)))

    def _of(self, notes: tuple[ChordNote, ...]) -> ChordStates:
        """The states for `notes`, from the lowest."""
        hands = self._hands
        right = hands[0].states(notes, hands[0].idle_places)
        left = hands[1].states(notes[::-1], hands[1].idle_places)
        forearms = self._forearm_costs(right, left)
        all_played = right.count[:, None] + left.count == len(notes)
        feasible = all_played & (forearms + right.cost[:, None] + left.cost < INFEASIBLE)
        in_right, in_left = feasible.any(axis=1), feasible.any(axis=0)
        right, left = right.subset(in_right), left.subset(in_left)
        return ChordStates(
            hands=(right, left),
            splits=tuple(
                (right.with_count(count), left.with_count(len(notes) - count))
                for count in sorted(set(right.count.tolist()))
            ),
            forearms=forearms[np.ix_(in_right, in_left)],
        )

    def _forearm_costs(self, right: HandStates, left: HandStates) -> Array:
        """Costs (R, L) of forearms near each other."""
        free_distance = self.reach.forearm_width + _FOREARM_ROOM
        shortfall = np.maximum(free_distance - (right.centre[:, None] + left.centre), 0.0)
        touch = self._players.forearms_touch(right.outmost[:, None], left.outmost)
        return _FOREARMS_NEAR * shortfall**2 + INFEASIBLE * touch


class _HandSpace:
    """The right hand, 0, or the left, 1.

    Attributes:
        idle_places: the places where it can be without notes [m].
        home: the place where it is before the first note [m].
    """

    def __init__(self, players: Players, hand: int) -> None:
        forearm = players.forearm(hand)
        self.idle_places = forearm.idle_places if forearm else (_FAR,)
        self.home = (forearm.home,) if forearm else (_FAR,)
        places = self.idle_places
        self._idle_slack = (places[1] - places[0]) / 2 if len(places) > 1 else 0.0
        self._low, self._high = (forearm.low, forearm.high) if forearm else (-_FAR, _FAR)
        self._hand, self._reach = hand, players.reach
        self._key_y = players.key_y(hand)
        self._is_black = players.keyboard.is_black
        # (K, F + 1) cost of each finger, or none, on each key.
        self._holding = np.pad(np.where(players.reaches(hand), 0.0, INFEASIBLE), ((0, 0), (0, 1)))

    def states(self, notes: tuple[ChordNote, ...], idle_places: tuple[float, ...]) -> HandStates:
        """The states for `notes`, from the thumb outwards; idle ones are at `idle_places` [m]."""
        y = self._key_y[[note.key for note in notes]]
        sets = finger_sets(len(y), self._reach)
        distance = y[sets.second] - y[sets.first]
        stretch = distance - sets.ease
        room = np.where(stretch > 0, sets.longer, sets.shorter)
        cost = sets.one_hot @ self._finger_costs(notes).ravel()
        cost += _STRETCH * (sets.played * (stretch / room) ** 2).sum(axis=1)
        at_rest = sets.mean @ y - sets.rest
        centre = np.clip(at_rest, self._low, self._high)
        offset = at_rest - centre
        cost += _STRETCH * (offset / np.where(offset > 0, sets.rightward, sets.leftward)) ** 2
        feasible = is_within(distance, sets.least, sets.most).all(axis=1) & (cost < INFEASIBLE)
        feasible[-1] = False  # the empty set, which has a state for each idle place
        cost[-1] = 0.0
        outmost = (y + sets.outward).min(axis=1, initial=self._high)
        idle = np.full(len(idle_places), len(feasible) - 1)
        rows = np.concatenate([feasible.nonzero()[0], idle])
        return HandStates(
            finger_set=rows,
            fingers=sets.fingers[rows].astype(np.uint8),
            count=sets.count[rows],
            playing=len(rows) - len(idle),
            idle_slack=self._idle_slack,
            centre=np.concatenate([centre[feasible], idle_places]),
            outmost=np.concatenate([outmost[feasible], idle_places]),
            cost=cost[rows],
        )

    def _finger_costs(self, notes: Sequence[ChordNote]) -> Array:
        """(m, F + 1) costs of each finger on each of the notes."""
        costs = self._holding[[note.key for note in notes]]
        reach, none = self._reach, self._reach.num_fingers
        for row, note in zip(costs, notes, strict=True):
            if not note.begins:  # its cost is that of the moment at which it began
                continue
            on_black = reach.effort_on_black if self._is_black[note.key] else 0.0
            row[:none] += reach.effort + on_black
            if note.finger is not None:
                is_ours = note.finger.hand == self._hand
                row[np.arange(none + 1) != (note.finger.index if is_ours else none)] = INFEASIBLE
            elif note.hand is not None:
                row[slice(none, None) if note.hand == self._hand else slice(none)] = INFEASIBLE
        return costs
