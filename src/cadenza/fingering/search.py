"""Finds which finger plays which note, where a score does not say.

What the hands cannot play is left out first, see `cadenza.fingering.playable`. The rest is found
by a dynamic programme (Viterbi) over the moments at which notes begin, for both hands at once.
Notes that sound together lie in the order of the fingers, so that what a hand does at a moment
is the set of its fingers that are down: of m sounding notes the left hand takes the lowest, the
right hand the highest. A hand without notes stands somewhere along the keyboard. From these states
and their transitions the cheapest sequence is found, exactly. Time and memory grow in proportion
to the number of moments: from 0.1 ms and 1 kB for each in two voices to 0.3 ms and 3 kB where many
notes sound.

Costs, about 1 for something worth avoiding once:

- stretching or squeezing fingers beyond their distances at rest, in proportion to what is left;
- fingers off their places at rest, where the forearm cannot slide to where they would be there;
- moving the hand along the keyboard: by the way, and by its square over the time there is;
- a finger that has to leave one key and press another, the less time there is between the two;
- fingers that would pass over or under one another from one moment to the next;
- another finger, or hand, on a key that is struck again;
- fingers that the hand's reach says to spare, on black keys or anywhere;
- forearms close to each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.changes import Costs, changes_of_fingers, transition
from cadenza.fingering.chords import NEVER, Asked, Chord, Chords
from cadenza.fingering.playable import playable
from cadenza.fingering.players import Players
from cadenza.fingering.strokes import Stroke
from cadenza.fingers import Finger
from cadenza.hands.reach import Array
from cadenza.music.score import LETTING_GO, Note, Score

COSTS = Costs()
"""Of what a hand does from moment to moment, if nothing else is said."""


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
    players: Players,
    progress: Callable[[int, int], None] | None = None,
    costs: Costs = COSTS,
) -> tuple[Score, tuple[Dropped, ...]]:
    """`score` with a finger on every note that the hands can play, none on those dropped.

    Fingers that the score gives are kept, and the others found to go with them. Where given
    fingers contradict each other or these hands, the others take no account of them. Given fingers
    that hands of this kind do not have count as not given.

    Args:
        score: with fingers or without.
        players: the hands that are there, and the keyboard.
        progress: is told how many notes have been looked at, and how many there are.
        costs: of what a hand does from moment to moment.

    Returns:
        The score, and what was dropped in the order of the notes.
    """
    score = _without_missing_fingers(score, players.reach.num_fingers)
    if all(note.finger is not None for note in score.notes):
        return score, ()
    asked = score, players, costs
    found = _last_found.get(asked)
    if found is None:
        solution = solve(score, players, progress, costs)
        found = solution.score.notes, solution.dropped
        _last_found.clear()
        _last_found[asked] = found
    notes, dropped = found  # of a score that is equal, but whose bars and tracks may be others
    return replace(score, notes=notes), dropped


def _without_missing_fingers(score: Score, num_fingers: int) -> Score:
    def missing(note: Note) -> bool:
        return note.finger is not None and note.finger.index >= num_fingers

    if not any(missing(note) for note in score.notes):
        return score
    notes = (replace(n, finger=None) if missing(n) else n for n in score.notes)
    return replace(score, notes=tuple(notes))


# What was found last: one song is often played in several tasks, as in training.
_last_found: dict[tuple[Score, Players, Costs], tuple[tuple[Note, ...], tuple[Dropped, ...]]] = {}


def solve(
    score: Score,
    players: Players,
    progress: Callable[[int, int], None] | None = None,
    costs: Costs = COSTS,
) -> Solution:
    """As `find_fingering`, with what it cost; of a score with all fingers the cost of those."""
    chords = chords_of(players)
    ways = beginning(chords)
    choices: list[Choice] = []
    chosen = playable(score, players)
    for sounding in chosen.moments:
        ways = ways_on(ways, sounding.time, sounding.strokes, chords, costs)
        choices.append(ways.choice)
        if progress:
            progress(sounding.begun, len(score.notes))
    found, _ = cheapest(ways.cost, choices, players.reach.num_fingers)
    fingers = chosen.unheeded | found
    notes = tuple(
        replace(note, finger=fingers.get(i)) if note.finger is None else note
        for i, note in enumerate(score.notes)
    )
    return Solution(
        score=replace(score, notes=notes),
        dropped=tuple(Dropped(notes[i], why) for i, why in sorted(chosen.reasons.items())),
        unheeded=tuple(notes[i] for i in sorted(chosen.unheeded)),
        cost=float(ways.cost.min()),
    )


# From moment to moment


class Choice(NamedTuple):
    """What has to be remembered of a moment, to tell in the end what the hands do in it."""

    strokes: tuple[Stroke, ...]
    fingers: tuple[NDArray[np.uint8], ...]  # right, left: (R, m), (L, m)
    left_before: NDArray[np.unsignedinteger]
    right_before: NDArray[np.unsignedinteger]


@dataclass(frozen=True, eq=False)
class Ways:
    """All ways to come to a moment: its states, and what they cost at the least.

    strokes             the m notes that sound, in the order of their keys
    cost (R, L)         of the cheapest way to this state of the right and this of the left hand
    left_before (R', L) the left hand's state before, and
    right_before (R, L) the right hand's, on that way
    """

    time: float
    strokes: tuple[Stroke, ...]
    chord: Chord
    cost: Array
    left_before: NDArray[np.unsignedinteger]
    right_before: NDArray[np.unsignedinteger]

    @property
    def choice(self) -> Choice:
        right, left = self.chord.hands
        return Choice(
            self.strokes, (right.fingers, left.fingers), self.left_before, self.right_before
        )


chords_of = lru_cache(maxsize=8)(Chords)


def beginning(chords: Chords) -> Ways:
    """Before the first note."""
    nothing = np.zeros((1, 1), np.uint8)
    return Ways(-1.0, (), chords.at_home(), np.zeros((1, 1)), nothing, nothing)


def ways_on(
    before: Ways,
    time: float,
    strokes: tuple[Stroke, ...],
    chords: Chords,
    costs: Costs = COSTS,
) -> Ways:
    """From a moment on to the next, at `time` [s], in which `strokes` sound."""
    asked = tuple(
        Asked(p.key, begins, p.finger if begins else None)
        for p in strokes
        for begins in (p.start >= time,)
    )
    chord = chords.of(asked)
    right, left = chord.hands
    right_was, left_was = before.chord.hands
    cost = np.full_like(chord.close, np.inf)
    through = np.empty((len(before.cost), len(left.cost)))  # (R', L) the cheapest over L'
    left_before = np.empty(through.shape, np.min_scalar_type(len(left_was.cost)))
    right_before = np.zeros(cost.shape, np.min_scalar_type(len(right_was.cost)))
    to_right, to_left = changes_of_fingers(before.strokes, strokes, time, chords.reach, costs)
    seconds = max(time - before.time, LETTING_GO)
    change = transition(left_was, left, to_left, seconds, costs)
    for was_right, was_left in before.chord.shared:
        ways = before.cost[was_right, None, was_left] + change[:, was_left]
        _least(ways, was_left.start, through[was_right], left_before[was_right])
    change = transition(right_was, right, to_right, seconds, costs)
    for is_right, is_left in chord.shared:
        ways = through.T[is_left] + change[is_right, None]
        _least(ways, 0, cost[is_right, is_left], right_before[is_right, is_left])
    cost += right.cost[:, None]
    cost += left.cost
    cost += chord.close
    cost[cost >= NEVER] = np.inf
    return Ways(time, strokes, chord, cost, left_before, right_before)


def _least(ways: Array, first: int, cost: Array, before: NDArray[np.unsignedinteger]) -> None:
    """Writes the least of the last axis of `ways` to `cost`, its place from `first` to `before`."""
    ways.min(axis=2, out=cost)
    np.add(ways.argmin(axis=2), first, out=before, casting="unsafe")


def cheapest(
    cost: Array, choices: Sequence[Choice], num_fingers: int
) -> tuple[dict[int, Finger], list[tuple[int, int]]]:
    """The way to the least of the last costs (R, L).

    Returns:
        Index of each note played -> its finger, and the states of both hands in each moment.
    """
    fingers: dict[int, Finger] = {}
    states = []
    state = np.unravel_index(cost.argmin(), cost.shape)
    for choice in reversed(choices):
        states.append((int(state[0]), int(state[1])))
        for hand, (indices, s) in enumerate(zip(choice.fingers, state, strict=True)):
            strokes = choice.strokes if hand == 0 else choice.strokes[::-1]
            for stroke, index in zip(strokes, indices[s].tolist(), strict=True):
                if index < num_fingers:  # else the other hand plays it
                    fingers |= dict.fromkeys(stroke.notes, Finger(hand, index))
        right, left = state
        right_before = choice.right_before[right, left]
        state = (right_before, choice.left_before[right_before, left])
    return fingers, states[::-1]
