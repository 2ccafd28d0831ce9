"""Finds which finger plays which note, where a score does not say.

A dynamic programme (Viterbi) over the moments at which notes begin, for both hands at once. Notes
that sound together lie in the order of the ten fingers, so that what a hand does at a moment is
the set of its fingers that are down: of m sounding notes the left hand takes the lowest, the right
hand the highest. A hand without notes stands somewhere along the keyboard. From these states and
their transitions the cheapest sequence is found, exactly; time is linear in the song's length.

Hard limits, of these hands on this keyboard:

- five notes a hand, their distances within what the fingers reach (`LEAST`, `MOST`);
- forearms that do not run into each other;
- a finger stays on its key as long as the note sounds; notes with less than `LETTING_GO` left
  when others begin count as over.

Costs, about 1 for something worth avoiding once:

- stretching or squeezing fingers beyond their distances at rest, in proportion to what is left;
- moving the hand along the keyboard: by the way, and by its square over the time there is;
- a finger that has to leave one key and press another, the less time there is between the two;
- fingers that would pass over or under one another from one moment to the next;
- another finger, or hand, on a key that is struck again;
- thumb and little finger on black keys, the weaker fingers anywhere;
- forearms close to each other.

Where notes cannot all be played, what sounds already goes on, and of the notes that begin the
outer ones are taken first: the highest and the lowest, then the next from outside, and so on; of
two equally far inside the louder, then the longer, then the higher. A note is dropped if it
cannot be played along with those taken before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.keyboard import IS_BLACK, KEY_Y
from cadenza.music.score import NUM_KEYS, UNKNOWN_FINGER, Note, Score

Array = NDArray[np.float64]
Side = Literal["right", "left"]

# Printed by tools/measure_reach.py: the right hand's fingers, thumb to little, on white keys [m].
REST = np.array([-0.0521, -0.0193, 0.0029, 0.0251, 0.0473])
"""(5,) where the fingertips are when all five press, to the right of the forearm."""
MOST = np.array(
    [
        [0.000, 0.085, 0.115, 0.147, 0.182],
        [0.000, 0.000, 0.082, 0.109, 0.127],
        [0.000, 0.000, 0.000, 0.085, 0.104],
        [0.000, 0.000, 0.000, 0.000, 0.085],
        [0.000, 0.000, 0.000, 0.000, 0.000],
    ]
)
"""(5, 5) the greatest distances of two fingers that press, the first nearer the thumb."""
LEAST = 0.0115 * np.maximum(np.arange(5) - np.arange(5)[:, None], 0)
"""(5, 5) the least: fingers side by side on neighbouring keys, which all pairs can reach."""

OUTWARD = np.array([0.092, 0.084, 0.060, 0.037, 0.018])
"""(5,) how far to the right of a fingertip that presses the forearm can be."""

LETTING_GO = 0.05  # [s] one control step
TOGETHER = 0.03  # [s] notes that begin within this time begin together
_HOME = 0.15  # [m] from the keyboard's middle, where the forearms are mounted
_APART = 0.149  # [m] forearms touch when they are nearer: twice their radius
_AT_EASE = 0.18  # [m] from here on the forearms do not mind each other
# Where a hand without notes can be [m]: there is always room for it beyond the other.
_STANDS = tuple(np.linspace(-0.75, 0.75, 32).tolist())
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

BOTH: tuple[Side, ...] = ("right", "left")


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
    sides: Sequence[Side] = BOTH,
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
    sides: Sequence[Side] = BOTH,
    progress: Callable[[int, int], None] | None = None,
) -> Solution:
    """As `find_fingering`, with what it cost; of a score with all fingers the cost of those."""
    places = [_STANDS if side in sides else _ELSEWHERE for side in BOTH]
    moment = _beginning(places)
    choices: list[_Choice] = []
    reasons: dict[int, str] = {}
    fingers: dict[int, int] = {}
    unheeded: list[int] = []
    for time, begin in _onsets(score):
        moment, left_out = _next_moment(moment, time, begin, places)
        choices.append(moment.choice)
        for press, reason in left_out:
            if press.finger == UNKNOWN_FINGER:
                reasons |= dict.fromkeys(press.notes, reason)
            else:
                fingers |= dict.fromkeys(press.notes, press.finger)
                unheeded += press.notes
        if progress:
            progress(begin[-1].notes[-1] + 1, len(score.notes))
    fingers |= _cheapest(moment.cost, choices)
    notes = tuple(
        replace(note, finger=fingers.get(i, UNKNOWN_FINGER))
        if note.finger == UNKNOWN_FINGER
        else note
        for i, note in enumerate(score.notes)
    )
    whose = "both hands" if len(sides) == 2 else f"the {sides[0]} hand"
    return Solution(
        score=replace(score, notes=notes),
        dropped=tuple(Dropped(notes[i], f"{reasons[i]} {whose}") for i in sorted(reasons)),
        unheeded=tuple(notes[i] for i in sorted(unheeded)),
        cost=float(moment.cost.min()),
    )


# What is pressed when


@dataclass(frozen=True, slots=True, eq=False)
class _Press:
    """A key going down for one or, where a score has them double, several `notes` (indices)."""

    key: int
    start: float
    end: float
    velocity: int
    finger: int
    notes: tuple[int, ...]


def _onsets(score: Score) -> Iterator[tuple[float, list[_Press]]]:
    """The moments at which notes begin, with what is pressed then.

    A note that is struck again while it sounds ends there.
    """
    moments: list[tuple[float, dict[int, list[int]]]] = []
    for i, note in enumerate(score.notes):
        if not moments or note.start > moments[-1][0] + TOGETHER:
            moments.append((note.start, {}))
        moments[-1][1].setdefault(note.key, []).append(i)
    struck_again = [float("inf")] * NUM_KEYS
    ends: dict[int, float] = {}
    for time, keys in reversed(moments):
        for key, indices in keys.items():
            ends[indices[0]] = min(max(score.notes[i].end for i in indices), struck_again[key])
            struck_again[key] = time
    for time, keys in moments:
        presses = []
        for key, indices in keys.items():
            notes = [score.notes[i] for i in indices]
            finger = next((n.finger for n in notes if n.finger >= 0), UNKNOWN_FINGER)
            loudest = max(note.velocity for note in notes)
            presses.append(_Press(key, time, ends[indices[0]], loudest, finger, tuple(indices)))
        yield time, presses


def _outer_first(begin: Sequence[_Press], held: Sequence[_Press]) -> list[_Press]:
    """In the order in which notes are taken: given ones, then from outside to inside."""
    keys = sorted({press.key for press in (*begin, *held)})
    place = {key: min(i, len(keys) - 1 - i) for i, key in enumerate(keys)}
    return sorted(
        begin,
        key=lambda p: (p.finger < 0, place[p.key], -p.velocity, p.start - p.end, -p.key),
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
    """S things that one hand can do at a moment.

    Everything is as if it were the right hand: of the left hand the keyboard is seen mirrored.
    """

    fingers: NDArray[np.intp]  # (S, m)
    one_hot: Array  # (S, 6 m)
    count: NDArray[np.intp]  # (S,) falls
    playing: tuple[slice, ...]  # (6,) the states in which it plays 0..5 of the notes
    centre: Array  # (S,) where the forearm is when the fingers are at rest [m]
    outmost: Array  # (S,) where it can be on the side of the little finger [m]
    cost: Array  # (S,)


class _Asked(NamedTuple):
    """A note that a hand is asked to begin, with the `finger` if it is known, or to go on with."""

    key: int
    begins: bool
    finger: int


@lru_cache(maxsize=1024)  # chords come again
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
    out = (distance < shapes.least) | (distance > shapes.most)
    able = ~out.any(axis=1) & (cost < _NEVER)
    able[-1] = False
    if stands == _ELSEWHERE:
        able[:] = False
    nothing = np.full(len(stands), len(able) - 1)
    rows = np.concatenate([able.nonzero()[0], nothing])
    centre = shapes.mean @ y - shapes.rest
    outmost = (y + shapes.outward).min(axis=1, initial=10.0)
    count = shapes.count[rows]
    first = len(count) - np.cumsum(np.bincount(count, minlength=6))  # of each number of notes
    return _States(
        fingers=shapes.fingers[rows],
        one_hot=shapes.one_hot[rows],
        count=count,
        playing=tuple(map(slice, first.tolist(), [len(count), *first[:-1].tolist()])),
        centre=np.concatenate([centre[able], stands]),
        outmost=np.concatenate([outmost[able], stands]),
        cost=cost[rows],
    )


# From moment to moment


class _Choice(NamedTuple):
    """What has to be remembered of a moment, to tell in the end what the hands do in it."""

    presses: tuple[_Press, ...]
    fingers: tuple[NDArray[np.uint8], ...]  # right, left: (R, m), (L, m)
    left_before: NDArray[np.uint8]
    right_before: NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class _Moment:
    """All states at a moment, and what they cost at the least.

    presses             the m notes that sound, in the order of their keys
    hands               right, left
    cost (R, L)         of the cheapest way to this state of the right and this of the left hand
    left_before (R', L) the left hand's state before, and
    right_before (R, L) the right hand's, on that way
    """

    time: float
    presses: tuple[_Press, ...]
    hands: tuple[_States, _States]
    cost: Array
    left_before: NDArray[np.uint8]
    right_before: NDArray[np.uint8]

    @property
    def shared(self) -> list[tuple[slice, slice]]:
        """States of the right and of the left hand that play all notes between them."""
        right, left = self.hands
        m = len(self.presses)
        return [
            (right.playing[k], left.playing[m - k]) for k in range(max(0, m - 5), min(m, 5) + 1)
        ]

    @property
    def choice(self) -> _Choice:
        fingers = tuple(hand.fingers.astype(np.uint8) for hand in self.hands)
        return _Choice(self.presses, fingers, self.left_before, self.right_before)


def _beginning(places: Sequence[_Place]) -> _Moment:
    right, left = (
        _states(side, (), (_HOME,) if place == _STANDS else place)
        for side, place in enumerate(places)
    )
    nothing = np.zeros((1, 1), np.uint8)
    return _Moment(-1.0, (), (right, left), np.zeros((1, 1)), nothing, nothing)


def _next_moment(
    before: _Moment, time: float, begin: Sequence[_Press], places: Sequence[_Place]
) -> tuple[_Moment, list[tuple[_Press, str]]]:
    """The moment `time` with as many of the notes that `begin` as can be played."""
    struck = {press.key for press in begin}
    held = [p for p in before.presses if p.end > time + LETTING_GO and p.key not in struck]
    most = 5 * sum(place == _STANDS for place in places)
    if len(held) + len(begin) <= most:
        whole = _moment(before, time, [*held, *begin], places)
        if whole.cost.min() < _NEVER:
            return whole, []
    moment = None
    left_out = []
    for press in _outer_first(begin, held):
        taken = held if moment is None else moment.presses
        if len(taken) == most:
            left_out.append((press, f"more than {most} notes at once for"))
            continue
        tried = _moment(before, time, [*taken, press], places)
        if tried.cost.min() < _NEVER:
            moment = tried
        else:
            left_out.append((press, _reason(tried)))
    return moment or _moment(before, time, held, places), left_out


def _reason(moment: _Moment) -> str:
    right, left = (set(hand.count[hand.cost < _NEVER].tolist()) for hand in moment.hands)
    if not any(len(moment.presses) - count in left for count in right):
        return "with the notes around it out of reach of"
    return "too far from what is held by"


def _moment(
    before: _Moment, time: float, presses: Sequence[_Press], places: Sequence[_Place]
) -> _Moment:
    presses = tuple(sorted(presses, key=lambda press: press.key))
    asked = tuple(
        _Asked(p.key, begins, p.finger if begins else UNKNOWN_FINGER)
        for p in presses
        for begins in (p.start >= time,)
    )
    right, left = (
        _states(side, asked[::order], place)
        for side, (order, place) in enumerate(zip((1, -1), places, strict=True))
    )
    close = _closeness(right, left)
    through = np.full((len(before.cost), len(left.cost)), np.inf)  # (R', L) the cheapest over L'
    cost = np.full(close.shape, np.inf)
    left_before, right_before = np.zeros(through.shape, np.uint8), np.zeros(cost.shape, np.uint8)
    moment = _Moment(time, presses, (right, left), cost, left_before, right_before)
    fits = close + right.cost[:, None] + left.cost < _NEVER
    if not any(fits[both].any() for both in moment.shared):
        return moment
    changes = _changes(before.presses, presses, time)
    seconds = max(time - before.time, LETTING_GO)
    to_right, to_left = (
        _transition(was, will, change, seconds)
        for was, will, change in zip(before.hands, moment.hands, changes, strict=True)
    )
    for was_right, was_left in before.shared:
        ways = before.cost[was_right, None, was_left] + to_left.T[:, was_left]
        _least(ways, was_left, through[was_right], left_before[was_right])
    for is_right, is_left in moment.shared:
        ways = through.T[is_left] + to_right.T[is_right, None]
        _least(ways, slice(0, None), cost[is_right, is_left], right_before[is_right, is_left])
    cost += right.cost[:, None]
    cost += left.cost
    cost += close
    cost[cost >= _NEVER] = np.inf
    return moment


def _least(ways: Array, among: slice, cost: Array, before: NDArray[np.uint8]) -> None:
    """Writes the least of the last axis of `ways` to `cost`, and its place `among` all `before`."""
    if ways.size:
        best = ways.argmin(axis=2)
        cost[...] = np.take_along_axis(ways, best[..., None], axis=2)[..., 0]
        before[...] = best + among.start


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


_UP = np.pad(np.tril(np.ones((5, 5)), -1), (0, 1))  # from a finger to one nearer the thumb
_DOWN = _UP.T
_SAME = np.pad(np.eye(5), (0, 1))
_OTHER = 1.0 - np.eye(6)


_TABLES = np.stack(  # (5, 72) of the right hand and of the left, whose keys rise to the thumb
    [[_OTHER, _OTHER], [_OTHER, _OTHER], [_SAME, _SAME], [_UP, _DOWN], [_DOWN, _UP]]
).reshape(5, 72)


def _changes(
    earlier: Sequence[_Press], now: Sequence[_Press], time: float
) -> tuple[Array, Array] | tuple[None, None]:
    """(6 m', 6 m) what it costs if a finger on a note before is followed by a finger on a note.

    Of the right hand and of the left; None where nothing costs anything.
    """
    keys_before = np.array([press.key for press in earlier])[:, None]
    keys = np.array([press.key for press in now])
    begins = np.array([press.start >= time for press in now])
    gap = np.array([[max(time - press.end, 0.0)] for press in earlier])
    if not earlier or not now:
        return None, None
    same_key = keys_before == keys
    struck = same_key & begins
    ended = [
        [not (any(p is q for q in now) or hit)]
        for p, hit in zip(earlier, struck.any(axis=1).tolist(), strict=True)
    ]
    moves = begins & ~same_key & ended
    hurry = 1 - np.minimum(gap / _TIME_TO_MOVE, 1.0)
    cross = _CROSSING * (1 - np.minimum(gap / _TIME_TO_CROSS, 1.0)) * moves
    up = keys > keys_before
    weights = np.empty((len(earlier), len(now), 5))
    weights[..., 0] = _NEVER * (same_key & ~begins)
    weights[..., 1] = _OTHER_FINGER * struck
    weights[..., 2] = _SAME_FINGER * hurry * moves
    weights[..., 3] = cross * up
    weights[..., 4] = cross * ~up
    if not weights.any():
        return None, None
    cost = (weights @ _TABLES).reshape(len(earlier), len(now), 2, 6, 6).transpose(2, 0, 3, 1, 4)
    shape = 6 * len(earlier), 6 * len(now)
    return cost[0].reshape(shape), cost[1, ::-1, :, ::-1].reshape(shape)


def _transition(was: _States, will: _States, change: Array | None, seconds: float) -> Array:
    """(S', S) what it costs a hand to go from one state to another in `seconds`."""
    way = np.abs(will.centre - was.centre[:, None])
    free = (was.count[:, None] == 0) | (will.count == 0)
    way = np.maximum(way - (_STANDS[1] - _STANDS[0]) / 2 * free, 0.0)
    cost = _WAY * way + _SPEED / seconds * way**2
    if change is not None:
        cost += was.one_hot @ change @ will.one_hot.T
    return cost


def _closeness(right: _States, left: _States) -> Array:
    """(R, L) what it costs that the forearms are near each other."""
    near = np.maximum(_AT_EASE - (right.centre[:, None] + left.centre), 0.0)
    touch = right.outmost[:, None] + left.outmost < _APART
    return _CLOSE * near**2 + _NEVER * touch


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
