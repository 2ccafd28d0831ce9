"""Finds which finger plays which note, where a score does not say.

What the hands cannot play is left out first, see `cadenza.fingering.playable`. The rest is found
by a dynamic programme (Viterbi) over the moments at which notes begin, for both hands at once.
Notes that sound together lie in the order of the ten fingers, so that what a hand does at a moment
is the set of its fingers that are down: of m sounding notes the left hand takes the lowest, the
right hand the highest. A hand without notes stands somewhere along the keyboard. From these states
and their transitions the cheapest sequence is found, exactly. Time and memory grow in proportion
to the number of moments: from 0.1 ms and 1 kB for each in two voices to 0.3 ms and 3 kB where many
notes sound.

Costs, about 1 for something worth avoiding once:

- stretching or squeezing fingers beyond their distances at rest, in proportion to what is left;
- moving the hand along the keyboard: by the way, and by its square over the time there is;
- a finger that has to leave one key and press another, the less time there is between the two;
- fingers that would pass over or under one another from one moment to the next;
- another finger, or hand, on a key that is struck again;
- thumb and little finger on black keys, the weaker fingers anywhere;
- forearms close to each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.playable import playable
from cadenza.fingering.presses import Press
from cadenza.fingering.reach import (
    HOME,
    LEAST,
    MOST,
    OUTWARD,
    REST,
    STANDS,
    Array,
    forearms_touch,
    is_within,
)
from cadenza.fingers import SIDES, UNKNOWN_FINGER, Side
from cadenza.music.keyboard import IS_BLACK, KEY_Y
from cadenza.music.score import LETTING_GO, Note, Score

_AT_EASE = 0.18  # [m] from here on the forearms do not mind each other
_ELSEWHERE = (10.0,)  # [m] where a hand that is not there is
_Place = tuple[float, ...]
_NO_FINGER = 5  # in place of a finger: not played by this hand
_NEVER = 1e9

_STRETCH = 1.0
_WAY = 8.0  # [1 / m]
_SPEED = 3.0  # [s / m^2]: 1 for 0.3 m in 0.25 s
_SAME_FINGER, _TIME_TO_MOVE = 2.0, 0.15  # [s] to lift, move and press
_CROSSING, _TIME_TO_CROSS = 0.5, 0.3  # [s]
_OTHER_FINGER = 1.0
_ON_BLACK = np.array([0.5, 0.0, 0.0, 0.0, 0.2, 0.0])
_WEAK = np.array([0.0, 0.0, 0.0, 0.1, 0.1, 0.0])
_CLOSE = 100.0  # [1 / m^2]


class Dropped(NamedTuple):
    """A note that is not played, and why, in plain words."""

    note: Note
    reason: str


@dataclass(frozen=True)
class Solution:
    """What a search found.

    Attributes:
        score: with a finger on every note that is played.
        dropped: what is not played.
        unheeded: notes whose given fingers contradict others, or these hands; they are kept.
        cost: of all fingers but the unheeded.
    """

    score: Score
    dropped: tuple[Dropped, ...]
    unheeded: tuple[Note, ...]
    cost: float


def find_fingering(
    score: Score,
    sides: Sequence[Side] = SIDES,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[Score, tuple[Dropped, ...]]:
    """`score` with a finger on every note that the hands can play, -1 on those dropped.

    Fingers that the score gives are kept, and the others found to go with them. Where given
    fingers contradict each other or these hands, the others take no account of them.

    Args:
        score: with fingers or without.
        sides: of the hands that are there.
        progress: is told how many notes have been looked at, and how many there are.

    Returns:
        The score, and what was dropped in the order of the notes.
    """
    if all(note.finger != UNKNOWN_FINGER for note in score.notes):
        return score, ()
    asked = score, tuple(sides)
    if asked not in _last_found:
        found = solve(score, sides, progress)
        _last_found.clear()
        _last_found[asked] = found.score, found.dropped
    return _last_found[asked]


# What was found last: a planner asks again for the score that its task has asked for.
_last_found: dict[tuple[Score, tuple[Side, ...]], tuple[Score, tuple[Dropped, ...]]] = {}


def solve(
    score: Score,
    sides: Sequence[Side] = SIDES,
    progress: Callable[[int, int], None] | None = None,
) -> Solution:
    """As `find_fingering`, with what it cost; of a score with all fingers the cost of those."""
    right, left = (STANDS if side in sides else _ELSEWHERE for side in SIDES)
    moment = _beginning((right, left))
    choices: list[_Choice] = []
    chosen = playable(score, sides)
    for sounding in chosen.moments:
        moment = _moment(moment, sounding.time, sounding.presses, (right, left))
        choices.append(moment.choice)
        if progress:
            progress(sounding.begun, len(score.notes))
    fingers = chosen.unheeded | _cheapest(moment.cost, choices)
    notes = tuple(
        replace(note, finger=fingers.get(i, UNKNOWN_FINGER))
        if note.finger == UNKNOWN_FINGER
        else note
        for i, note in enumerate(score.notes)
    )
    return Solution(
        score=replace(score, notes=notes),
        dropped=tuple(Dropped(notes[i], why) for i, why in sorted(chosen.reasons.items())),
        unheeded=tuple(notes[i] for i in sorted(chosen.unheeded)),
        cost=float(moment.cost.min()),
    )


# What a hand can do


@dataclass(frozen=True, eq=False)
class _Shapes:
    """What a hand can do about `m` sounding notes: S sets of fingers on the last of them.

    The notes lie from the thumb's side to the little finger's; the last row is the empty set.
    Pairs are the P pairs of notes, the first nearer the thumb.

    fingers (S, m)      the finger on each note, or none
    one_hot (S, 6 m)    the same
    count (S,)          notes played
    mean (S, m)         weights that give the mean of the notes played
    rest (S,)           the mean of their fingers' offsets from the forearm [m]
    outward (S, m)      how far beyond each note the forearm can be [m]
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
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    least: Array
    ease: Array
    most: Array
    longer: Array
    shorter: Array
    played: Array


def _with_no_finger(table: Array, value: float) -> Array:
    return np.pad(table, (0, 1), constant_values=value)


@cache
def _shapes(m: int) -> _Shapes:
    sets = [s for k in range(min(m, 5), -1, -1) for s in combinations(range(5), k)]
    fingers = np.array([(_NO_FINGER,) * (m - len(s)) + s for s in sets], np.intp)
    fingers = fingers.reshape(len(sets), m)
    played = fingers != _NO_FINGER
    count = played.sum(axis=1)
    weights = played / np.maximum(count, 1)[:, None]
    first, second = np.triu_indices(m, 1)
    pair = fingers[:, first], fingers[:, second]
    least = _with_no_finger(LEAST, -10.0)[pair]
    ease = _with_no_finger(REST - REST[:, None], 0.0)[pair]
    most = _with_no_finger(MOST, 10.0)[pair]
    return _Shapes(
        fingers=fingers,
        one_hot=np.eye(6)[fingers].reshape(len(sets), 6 * m),
        count=count,
        mean=weights,
        rest=(weights * np.append(REST, 0.0)[fingers]).sum(axis=1),
        outward=np.append(OUTWARD, 10.0)[fingers],
        first=first,
        second=second,
        least=least,
        ease=ease,
        most=most,
        longer=most - ease,
        shorter=ease - least,
        played=(played[:, first] & played[:, second]).astype(float),
    )


@dataclass(frozen=True, eq=False)
class _States:
    """S things that one hand can do at a moment: first N in which it plays notes, then others.

    Everything is as if it were the right hand: of the left hand the keyboard is seen mirrored.
    """

    shape: NDArray[np.intp]  # (S,) row of `_shapes`
    fingers: NDArray[np.uint8]  # (S, m)
    count: NDArray[np.intp]  # (S,) falls
    playing: int  # N
    centre: Array  # (S,) where the forearm is when the fingers are at rest [m]
    outmost: Array  # (S,) where it can be on the side of the little finger [m]
    cost: Array  # (S,)

    def only(self, those: NDArray[np.bool_]) -> _States:
        return _States(
            shape=self.shape[those],
            fingers=self.fingers[those],
            count=self.count[those],
            playing=int(np.count_nonzero(self.count[those])),
            centre=self.centre[those],
            outmost=self.outmost[those],
            cost=self.cost[those],
        )

    def that_play(self, notes: int) -> slice:
        """The states in which this many notes are played."""
        first, end = np.searchsorted(-self.count, [-notes, 1 - notes]).tolist()
        return slice(first, end)


class _Asked(NamedTuple):
    """A note that a hand is asked to begin, with the `finger` if it is known, or to go on with."""

    key: int
    begins: bool
    finger: int


def _states(side: int, asked: tuple[_Asked, ...], stands: _Place) -> _States:
    """What a hand can do about the notes it is `asked` for, from the thumb's side.

    Without notes it is where it `stands` [m].
    """
    y = (1.0, -1.0)[side] * KEY_Y[[note.key for note in asked]]
    wanted = _wanted(asked, side)
    shapes = _shapes(len(y))
    distance = y[shapes.second] - y[shapes.first]
    beyond = distance - shapes.ease
    room = np.where(beyond > 0, shapes.longer, shapes.shorter)
    cost = shapes.one_hot @ wanted.ravel()
    cost += _STRETCH * (shapes.played * (beyond / room) ** 2).sum(axis=1)
    able = is_within(distance, shapes.least, shapes.most).all(axis=1) & (cost < _NEVER)
    able[-1] = False
    if stands == _ELSEWHERE:
        able[:] = False
    nothing = np.full(len(stands), len(able) - 1)
    rows = np.concatenate([able.nonzero()[0], nothing])
    centre = shapes.mean @ y - shapes.rest
    outmost = (y + shapes.outward).min(axis=1, initial=10.0)
    return _States(
        shape=rows,
        fingers=shapes.fingers[rows].astype(np.uint8),
        count=shapes.count[rows],
        playing=len(rows) - len(stands),
        centre=np.concatenate([centre[able], stands]),
        outmost=np.concatenate([outmost[able], stands]),
        cost=cost[rows],
    )


def _wanted(asked: Sequence[_Asked], side: int) -> Array:
    """(m, 6) what each finger on each of the notes costs."""
    wanted = np.zeros((len(asked), 6))
    for row, note in zip(wanted, asked, strict=True):
        if not note.begins:  # paid for
            continue
        row += _WEAK + (_ON_BLACK if IS_BLACK[note.key] else 0.0)
        if note.finger != UNKNOWN_FINGER:
            ours = note.finger // 5 == side
            row[np.arange(6) != (note.finger % 5 if ours else _NO_FINGER)] = _NEVER
    return wanted


@dataclass(frozen=True, eq=False)
class _Chord:
    """What both hands can do about notes that sound together.

    hands           right, left: R and L states that go with some state of the other
    shared          where they play all notes between them, as blocks of (R, L)
    close (R, L)    what it costs that the forearms are near each other
    """

    hands: tuple[_States, _States]
    shared: tuple[tuple[slice, slice], ...]
    close: Array


@lru_cache(maxsize=2048)  # chords come again
def _chord(asked: tuple[_Asked, ...], places: tuple[_Place, _Place]) -> _Chord:
    right, left = _states(0, asked, places[0]), _states(1, asked[::-1], places[1])
    close = _closeness(right, left)
    all_played = right.count[:, None] + left.count == len(asked)
    fits = all_played & (close + right.cost[:, None] + left.cost < _NEVER)
    in_right, in_left = fits.any(axis=1), fits.any(axis=0)
    right, left = right.only(in_right), left.only(in_left)
    return _Chord(
        hands=(right, left),
        shared=tuple(
            (right.that_play(count), left.that_play(len(asked) - count))
            for count in sorted(set(right.count.tolist()))
        ),
        close=close[np.ix_(in_right, in_left)],
    )


def _closeness(right: _States, left: _States) -> Array:
    """(R, L) what it costs that the forearms are near each other."""
    near = np.maximum(_AT_EASE - (right.centre[:, None] + left.centre), 0.0)
    touch = forearms_touch(right.outmost[:, None], left.outmost)
    return _CLOSE * near**2 + _NEVER * touch


# From moment to moment


class _Choice(NamedTuple):
    """What has to be remembered of a moment, to tell in the end what the hands do in it."""

    presses: tuple[Press, ...]
    fingers: tuple[NDArray[np.uint8], ...]  # right, left: (R, m), (L, m)
    left_before: NDArray[np.uint8]
    right_before: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _Moment:
    """All states at a moment, and what they cost at the least.

    presses             the m notes that sound, in the order of their keys
    cost (R, L)         of the cheapest way to this state of the right and this of the left hand
    left_before (R', L) the left hand's state before, and
    right_before (R, L) the right hand's, on that way
    """

    time: float
    presses: tuple[Press, ...]
    chord: _Chord
    cost: Array
    left_before: NDArray[np.uint8]
    right_before: NDArray[np.uint8]

    @property
    def choice(self) -> _Choice:
        right, left = self.chord.hands
        return _Choice(
            self.presses, (right.fingers, left.fingers), self.left_before, self.right_before
        )


def _beginning(places: tuple[_Place, _Place]) -> _Moment:
    right, left = ((HOME,) if place == STANDS else place for place in places)
    nothing = np.zeros((1, 1), np.uint8)
    return _Moment(-1.0, (), _chord((), (right, left)), np.zeros((1, 1)), nothing, nothing)


def _moment(
    before: _Moment, time: float, presses: tuple[Press, ...], places: tuple[_Place, _Place]
) -> _Moment:
    asked = tuple(
        _Asked(p.key, begins, p.finger if begins else UNKNOWN_FINGER)
        for p in presses
        for begins in (p.start >= time,)
    )
    chord = _chord(asked, places)
    right, left = chord.hands
    right_was, left_was = before.chord.hands
    cost = np.full_like(chord.close, np.inf)
    through = np.empty((len(before.cost), len(left.cost)))  # (R', L) the cheapest over L'
    left_before, right_before = np.empty(through.shape, np.uint8), np.zeros(cost.shape, np.uint8)
    to_right, to_left = _changes(before.presses, presses, time)
    seconds = max(time - before.time, LETTING_GO)
    change = _transition(left_was, left, to_left, seconds)
    for was_right, was_left in before.chord.shared:
        ways = before.cost[was_right, None, was_left] + change[:, was_left]
        _least(ways, was_left.start, through[was_right], left_before[was_right])
    change = _transition(right_was, right, to_right, seconds)
    for is_right, is_left in chord.shared:
        ways = through.T[is_left] + change[is_right, None]
        _least(ways, 0, cost[is_right, is_left], right_before[is_right, is_left])
    cost += right.cost[:, None]
    cost += left.cost
    cost += chord.close
    cost[cost >= _NEVER] = np.inf
    return _Moment(time, presses, chord, cost, left_before, right_before)


def _least(ways: Array, first: int, cost: Array, before: NDArray[np.uint8]) -> None:
    """Writes the least of the last axis of `ways` to `cost`, its place from `first` to `before`."""
    ways.min(axis=2, out=cost)
    np.add(ways.argmin(axis=2), first, out=before, casting="unsafe")


def _transition(was: _States, will: _States, change: Array | None, seconds: float) -> Array:
    """(S, S') what it costs a hand to go from one state to another in `seconds`."""
    way = np.abs(will.centre[:, None] - was.centre)
    free = (STANDS[1] - STANDS[0]) / 2  # a hand without notes may be between two stands
    way[will.playing :] -= free
    way[: will.playing, was.playing :] -= free
    np.maximum(way, 0.0, out=way)
    cost = way**2
    cost *= _SPEED / seconds
    way *= _WAY
    cost += way
    if change is not None:
        cost += change[will.shape[:, None], was.shape]
    return cost


# What a note is to one of the moment before; higher or lower if it begins when that has ended.
_UNRELATED, _HELD, _STRUCK_AGAIN, _HIGHER, _LOWER = range(5)


def _changes(
    earlier: Sequence[Press], now: Sequence[Press], time: float
) -> tuple[Array, Array] | tuple[None, None]:
    """As `_costs_of_changes`; None where nothing costs anything."""
    keys = {press.key for press in now}
    begins = [press.start >= time for press in now]
    gaps = tuple([min(max(time - press.end, 0.0), _TIME_TO_CROSS) for press in earlier])
    changes = []
    for was, gap in zip(earlier, gaps, strict=True):
        if was.key in keys:
            changes += [
                _UNRELATED if will.key != was.key else _STRUCK_AGAIN if new else _HELD
                for will, new in zip(now, begins, strict=True)
            ]
        elif gap < _TIME_TO_CROSS:
            changes += [
                (_HIGHER if will.key > was.key else _LOWER) if new else _UNRELATED
                for will, new in zip(now, begins, strict=True)
            ]
        else:
            changes += [_UNRELATED] * len(now)
    return _costs_of_changes(tuple(changes), gaps) if any(changes) else (None, None)


_UP = np.pad(np.tril(np.ones((5, 5)), -1), (0, 1))  # from a finger to one nearer the thumb
_DOWN = _UP.T
_SAME = np.pad(np.eye(5), (0, 1))
_OTHER = 1.0 - np.eye(6)
_TABLES = np.stack(  # (5, 72) of the right hand and of the left, whose keys rise to the thumb
    [[_OTHER, _OTHER], [_OTHER, _OTHER], [_SAME, _SAME], [_UP, _DOWN], [_DOWN, _UP]]
).reshape(5, 72)


@lru_cache(maxsize=1024)  # figures come again
def _costs_of_changes(changes: tuple[int, ...], gaps: tuple[float, ...]) -> tuple[Array, Array]:
    """(S, S') of `_shapes`: what it costs the right and the left hand to come from other fingers.

    Args:
        changes: what each of m notes is to each of m' before, (m' m,).
        gaps: between those before and now (m',) [s].
    """
    change = np.array(changes).reshape(len(gaps), -1)
    gap = np.array(gaps)[:, None]
    cross = _CROSSING * (1 - np.minimum(gap / _TIME_TO_CROSS, 1.0))
    hurry = _SAME_FINGER * (1 - np.minimum(gap / _TIME_TO_MOVE, 1.0))
    weights = np.stack(
        [
            _NEVER * (change == _HELD),
            _OTHER_FINGER * (change == _STRUCK_AGAIN),
            hurry * (change >= _HIGHER),
            cross * (change == _HIGHER),
            cross * (change == _LOWER),
        ],
        axis=-1,
    )
    costs = (weights @ _TABLES).reshape(*change.shape, 2, 6, 6).transpose(2, 0, 3, 1, 4)
    fingers_before, fingers = (_shapes(m).one_hot for m in change.shape)
    shape = fingers_before.shape[1], fingers.shape[1]
    right, left = costs[0].reshape(shape), costs[1, ::-1, :, ::-1].reshape(shape)
    return (
        np.ascontiguousarray((fingers_before @ right @ fingers.T).T),
        np.ascontiguousarray((fingers_before @ left @ fingers.T).T),
    )


def _cheapest(cost: Array, choices: Sequence[_Choice]) -> dict[int, int]:
    """Index of each note played -> its finger, on the way to the least of the last costs (R, L)."""
    fingers: dict[int, int] = {}
    state = np.unravel_index(cost.argmin(), cost.shape)
    for choice in reversed(choices):
        for side, (hand, s) in enumerate(zip(choice.fingers, state, strict=True)):
            presses = choice.presses if side == 0 else choice.presses[::-1]
            for press, finger in zip(presses, hand[s].tolist(), strict=True):
                if finger != _NO_FINGER:
                    fingers |= dict.fromkeys(press.notes, 5 * side + finger)
        right, left = state
        right_before = choice.right_before[right, left]
        state = (right_before, choice.left_before[right_before, left])
    return fingers
