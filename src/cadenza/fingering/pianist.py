"""Fingers as a pianist would choose them, within the limits of these hands.

The costs are the rules of R. Parncutt, J. A. Sloboda, E. F. Clarke, M. Raekallio and P. Desain, "An
ergonomic model of keyboard fingering for melodic fragments", Music Perception 14 (4), 1997, pp.
341-382, as J. P. Jacobs refined them, "Refinements to the ergonomic model ...", 18 (4), 2001, pp.
505-511: the little finger is not weak, large spans cost the same for all fingers, and there is no
rule 7. (He also counts distances in millimetres; here they are in semitones.) The figures are taken
from two open implementations, `dvdrndlph/pydactyl` and `vibetuned/counterpoint`, which agree in all
but one.

The rules are for melodies, and consider one to three notes. For chords, the cost between successive
moments is the mean over their notes, and the rules on spans hold within chords, too. The costs of
cases that the rules exclude are ours: a finger that goes to another key, impractical spans, and
another finger on a repeated key. The longer a hand rests, the less its last place matters.

Each hand is searched by itself, by a dynamic programme (Viterbi) whose states are the fingers that
are down at two successive moments.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, lru_cache
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.fingering.players import Players, ways_to_hold
from cadenza.fingering.search import Dropped, solve
from cadenza.fingering.states import INFEASIBLE
from cadenza.fingering.strokes import Stroke, onsets
from cadenza.fingers import RIGHT, SIDES, Finger
from cadenza.hands.reach import Array
from cadenza.music.score import MIDI_PITCHES, MIRROR, RELEASE_TIME, Score, is_black

_SPANS = {  # semitones upwards from one finger of a right hand to another
    # MinPrac, MinComf, MinRel, MaxRel, MaxComf, MaxPrac
    (0, 1): (-5, -3, 1, 5, 8, 10),
    (0, 2): (-4, -2, 3, 7, 10, 12),
    (0, 3): (-3, -1, 5, 9, 12, 14),
    (0, 4): (-1, 1, 7, 10, 13, 15),  # the one on which they differ: MaxRel is 11 in counterpoint
    (1, 2): (1, 1, 1, 2, 3, 5),
    (1, 3): (1, 1, 3, 4, 5, 7),
    (1, 4): (2, 2, 5, 6, 8, 10),
    (2, 3): (1, 1, 1, 2, 2, 4),
    (2, 4): (1, 1, 3, 4, 5, 7),
    (3, 4): (1, 1, 1, 2, 3, 5),
}
_THUMB, _MIDDLE, _RING, _LITTLE = 0, 2, 3, 4
_NUM_FINGERS = 5
_SAME_FINGER = 10.0  # cost of a finger that goes to another key, and 1 for each semitone
_IMPRACTICAL = 10.0  # cost of a span that is not practical
_OTHER_FINGER = 2.0  # cost of another finger on a repeated key
_REST = 0.5  # [s] after which the last place of the hand does not matter
_FARTHEST = MIDI_PITCHES[-1]  # semitones
_BLACK = np.array([is_black(pitch) for pitch in MIDI_PITCHES], np.intp)


def pianist_fingering(
    score: Score, players: Players, progress: Callable[[int, int], None] | None = None
) -> tuple[Score, tuple[Dropped, ...]]:
    """`score` with a pianist's fingers on every note that the hands can play, none on the others.

    Notes are divided between the hands as written, if possible, or else by `find_fingering`. No
    fingers of the score are kept. `progress` receives the number of notes done, and of all. Raises
    CadenzaError if the hands have more than five fingers. Returns the score, and the dropped notes
    in order.
    """
    if players.reach.num_fingers > _NUM_FINGERS:
        raise CadenzaError("a pianist has five fingers, these hands have more: leave out human")
    split = solve(score.without_fingers(), players, progress, as_written=True)
    fingers: list[Finger | None] = [None] * len(score.notes)
    moments = list(onsets(split.held, players.keyboard.lowest_pitch))
    for hand in range(len(SIDES)):
        for stroke, index in _HandSearch(hand, players).fingers(moments):
            for note in stroke.notes:
                fingers[note] = Finger(hand, index)
    return score.with_fingers(fingers), split.dropped


class _Moment(NamedTuple):
    """A moment at which a hand strikes m of the n keys that it then holds, in one of S ways.

    Notes are in the order of the fingers.

    time                    the time [s]
    strokes (n,)            the held keys
    fingers (S, n)          the fingers on them
    places (n,)             their pitches, mirrored for the left hand
    struck (m,)             indices of the keys that are struck
    """

    time: float
    strokes: tuple[Stroke, ...]
    fingers: NDArray[np.intp]
    places: NDArray[np.intp]
    struck: list[int]

    @property
    def striking(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Fingers (S, m) and places (m,) of the struck keys."""
        return self.fingers[:, self.struck], self.places[self.struck]

    @property
    def end(self) -> float:
        """The end of the last note that is struck [s]."""
        return max(self.strokes[i].end for i in self.struck)


class _HandSearch:
    """The search for the fingers of the right hand, 0, or the left, 1."""

    def __init__(self, hand: int, players: Players) -> None:
        self._hand, self._lowest = hand, players.keyboard.lowest_pitch
        self._reaches, self._spans = players.reaches(hand), players.spans()
        self._ways = lru_cache(maxsize=512)(self._ways_to_hold)  # chords recur

    def fingers(
        self, moments: Iterable[tuple[float, list[Stroke]]]
    ) -> Iterator[tuple[Stroke, int]]:
        """Yield the strokes of this hand, and the indices of the best fingers."""
        of_hand = list(self._moments(moments))
        for moment, way in zip(of_hand, _best_ways(of_hand), strict=True):
            for i in moment.struck:
                yield moment.strokes[i], int(moment.fingers[way, i])

    def _moments(self, moments: Iterable[tuple[float, list[Stroke]]]) -> Iterator[_Moment]:
        held: list[Stroke] = []
        for time, strokes in moments:
            struck = [s for s in strokes if s.finger is not None and s.finger.hand == self._hand]
            if not struck:
                continue
            held = [stroke for stroke in held if stroke.end > time + RELEASE_TIME] + struck
            held.sort(key=lambda stroke: stroke.key, reverse=self._hand != RIGHT)
            pitches = np.array([stroke.key + self._lowest for stroke in held])
            yield _Moment(
                time,
                tuple(held),
                self._ways(tuple(stroke.key for stroke in held)),
                pitches if self._hand == RIGHT else MIRROR - pitches,
                [i for i, stroke in enumerate(held) if stroke in struck],
            )

    def _ways_to_hold(self, keys: tuple[int, ...]) -> NDArray[np.intp]:
        """(S, n) the sets of fingers that reach keys together."""
        ways = list(ways_to_hold(keys, self._reaches, self._spans))
        return np.array(ways, np.intp).reshape(len(ways), len(keys))


def _best_ways(moments: Sequence[_Moment]) -> list[int]:
    """The cheapest sequence of ways to hold keys, one at each moment."""
    if not moments:
        return []
    cost = _cost_of_moment(moments[0])[None]  # (S', S) by the ways at two moments
    backpointers: list[NDArray[np.intp]] = []
    before: _Moment | None = None
    weight_before = 0.0
    for now, after in pairwise(moments):
        weight = max(1 - max(after.time - now.end, 0.0) / _REST, 0.0)
        paths = np.repeat(cost[..., None], len(after.fingers), axis=2)
        if before is not None and weight * weight_before:
            paths += weight * weight_before * _cost_of_three(before, now, after)
        backpointers.append(paths.argmin(axis=0))
        cost = paths.min(axis=0) + _cost_of_holding(now, after) + _cost_of_moment(after)
        if weight:
            cost += weight * _cost_of_two(now, after)
        before, weight_before = now, weight
    way_before, way = (int(i) for i in np.unravel_index(cost.argmin(), cost.shape))
    ways = [way]
    for pointers in reversed(backpointers):
        way_before, way = int(pointers[way_before, way]), way_before
        ways.append(way)
    return ways[::-1]


def _cost_of_moment(now: _Moment) -> Array:
    """Costs (S,) of the struck keys: rules 6 and 10, and spans of chords."""
    fingers, places = now.striking
    cost = (fingers == _RING).sum(axis=1) + (fingers == _THUMB) @ _BLACK[places]
    spans = _tables().spans
    for i, j in combinations(range(len(now.places)), 2):
        if i in now.struck or j in now.struck:
            distance = now.places[j] - now.places[i]
            cost = cost + spans[now.fingers[:, i], now.fingers[:, j], distance + _FARTHEST]
    return np.asarray(cost, np.float64)


def _cost_of_holding(before: _Moment, now: _Moment) -> Array:
    """Costs (S', S) that forbid another finger on a key that stays down."""
    cost = np.zeros((len(before.fingers), len(now.fingers)))
    for i, stroke in enumerate(now.strokes):
        if i not in now.struck:
            finger = before.fingers[:, before.strokes.index(stroke), None]
            cost += INFEASIBLE * (finger != now.fingers[:, i])
    return cost


def _cost_of_two(before: _Moment, now: _Moment) -> Array:
    """Costs (S', S) of strokes at two successive moments."""
    (first, p), (second, q) = before.striking, now.striking
    costs = _tables().pairs[
        _BLACK[p][:, None],
        _BLACK[q],
        first[:, None, :, None],
        second[:, None, :],
        q - p[:, None] + _FARTHEST,
    ]
    return np.asarray(costs.mean(axis=(2, 3)))


def _cost_of_three(first: _Moment, second: _Moment, third: _Moment) -> Array:
    """Costs (S'', S', S) of strokes at three successive moments."""
    (f, p), (g, q), (h, r) = first.striking, second.striking, third.striking
    f, g, h = f[:, None, None, :, None, None], g[:, None, None, :, None], h[:, None, None, :]
    p, q = p[:, None, None], q[:, None]
    tables, distance = _tables(), r - p + _FARTHEST
    between = (np.minimum(p, r) < q) & (q < np.maximum(p, r))
    cost = tables.changes[f, h, distance]
    cost = cost + tables.full_changes[f, h, distance] * (between & (g == _THUMB))
    return np.asarray(cost.mean(axis=(3, 4, 5)))


class _Tables(NamedTuple):
    """Costs of two fingers (5, 5) on notes whose distance is the last index.

    spans           of the distance (rules 1 to 3)
    pairs           of successive notes, first by the colours of their keys: 1 is black
    changes         of the first and the third of three notes (rules 4 and 5)
    full_changes    added if the thumb plays the second note between them
    """

    spans: Array
    pairs: Array
    changes: Array
    full_changes: Array


@cache
def _tables() -> _Tables:
    """The rules of one, two and three notes."""
    finger = np.arange(_NUM_FINGERS)
    limits = np.zeros((6, _NUM_FINGERS, _NUM_FINGERS, 1))
    for (low, high), span in _SPANS.items():
        limits[:, low, high, 0] = limits[:, high, low, 0] = span
    min_prac, min_comf, min_rel, max_rel, max_comf, max_prac = limits
    first, second = finger[:, None, None], finger[:, None]
    distance = np.arange(-_FARTHEST, _FARTHEST + 1)
    outwards = np.where(first < second, distance, -distance)
    with_thumb = (first == _THUMB) ^ (second == _THUMB)
    uncomfortable = np.maximum(min_comf - outwards, 0) + np.maximum(outwards - max_comf, 0)
    small, large = np.maximum(min_rel - outwards, 0), np.maximum(outwards - max_rel, 0)
    impractical = (outwards < min_prac) | (outwards > max_prac)
    spans = 2 * uncomfortable + np.where(with_thumb, 1, 2) * small + large
    spans = spans + _IMPRACTICAL * impractical
    spans = np.where(first == second, _SAME_FINGER + np.abs(distance), spans)
    spans = np.where(distance == 0, _OTHER_FINGER * (first != second), spans)
    changes = (1 + uncomfortable) * (uncomfortable > 0) + ((distance == 0) & (first != second))

    black, next_black = (np.arange(2).reshape(shape) for shape in ((2, 1, 1, 1, 1), (2, 1, 1, 1)))
    onto_black, off_black = next_black * (1 - black), black * (1 - next_black)
    to_ring, to_middle = (
        (first == a) & (second == b) for a, b in ((_MIDDLE, _RING), (_RING, _MIDDLE))
    )
    moving = to_ring + to_ring * onto_black + to_middle * off_black  # rules 8 and 9
    for outer in _THUMB, _LITTLE:  # rules 10 and 11
        moving = moving + 2 * ((first == outer) * off_black + (second == outer) * onto_black)
    thumb_black = np.where(first == _THUMB, off_black, onto_black)
    passing = with_thumb & (outwards < 0)
    moving = moving + passing * np.where(black == next_black, 1, 3 * thumb_black)  # rule 12
    pairs = spans + moving * (distance != 0)
    full_changes = (uncomfortable > 0) & impractical
    return _Tables(spans, pairs, changes, full_changes.astype(np.float64))
