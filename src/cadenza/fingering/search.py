"""The search for fingers of notes to which a score gives none.

Notes that the hands cannot play are left out first, see `cadenza.fingering.playable`. The fingers
of the others are found by a dynamic programme (Viterbi) over the moments at which notes begin, for
both hands at once. Notes that sound together lie in the order of the fingers, so that the state of
a hand is the set of its fingers that are down: of m sounding notes, the left hand takes the lowest
and the right hand the highest. A hand without notes stands somewhere along the keyboard. The
cheapest sequence of these states is found exactly. Time and memory are proportional to the number
of moments: from 0.1 ms and 1 kB each in two voices to 0.3 ms and 3 kB in thick chords.

Costs, about 1 for something worth avoiding once:

- stretching or squeezing fingers beyond their distances at rest, as a share of their range;
- fingers off their places at rest, if the forearm cannot slide there;
- moving the hand along the keyboard: the distance, and its square over the time;
- a finger that has to go from one key to another, the more the less time it has;
- fingers that pass over or under one another from one moment to the next;
- another finger, or hand, on a repeated key;
- the effort of fingers by the hand's reach, on black keys or anywhere;
- forearms close to each other.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.fingering.playable import playable
from cadenza.fingering.players import Players
from cadenza.fingering.states import INFEASIBLE, ChordNote, ChordStates, StateSpace
from cadenza.fingering.strokes import Stroke
from cadenza.fingering.transitions import Costs, finger_change_costs, transition_costs
from cadenza.fingers import Finger
from cadenza.hands.reach import Array
from cadenza.music.score import RELEASE_TIME, Note, Score

COSTS = Costs()


class Dropped(NamedTuple):
    """A note that is not played, and the reason in plain words."""

    note: Note
    reason: str


@dataclass(frozen=True)
class Solution:
    """The result of a search.

    Attributes:
        score: the score with a finger on every note that is played.
        dropped: the notes that are not played.
        ignored: notes whose given fingers contradict others, or these hands, and are kept.
        held: the score, with notes that end when they are released.
        cost: the cost of all fingers except ignored ones.
    """

    score: Score
    dropped: tuple[Dropped, ...]
    ignored: tuple[Note, ...]
    held: Score
    cost: float


def find_fingering(
    score: Score,
    players: Players,
    progress: Callable[[int, int], None] | None = None,
    costs: Costs = COSTS,
    as_written: bool = False,
) -> tuple[Score, tuple[Dropped, ...]]:
    """`score` with a finger on every note that the hands can play, none on dropped notes.

    Fingers that the score gives are kept, and the others fit them. Given fingers that contradict
    each other or these hands are kept, but the others do not fit them. Given fingers that hands of
    this kind do not have are removed. Returns the score, and the dropped notes in order.

    Args:
        score: a score with fingers or without.
        players: the hands and the keyboard.
        progress: receives the number of notes done, and of all.
        costs: weights of the costs between moments.
        as_written: whether each hand plays the notes written for it, if it can.
    """
    score = _without_missing_fingers(score, players.reach.num_fingers)
    if all(note.finger is not None for note in score.notes):
        return score, ()
    solution = solve(score, players, progress, costs, as_written)
    # Equal scores may differ in bars and tracks.
    return score.with_fingers(n.finger for n in solution.score.notes), solution.dropped


def _without_missing_fingers(score: Score, num_fingers: int) -> Score:
    """`score` without the fingers that hands of `num_fingers` do not have."""
    fingers = (note.finger for note in score.notes)
    return score.with_fingers(f if f and f.index < num_fingers else None for f in fingers)


# One song is often played in several tasks, as in training.
_last_solution: dict[tuple[Score, Players, Costs, tuple[tuple[int, ...], ...]], Solution] = {}


def solve(
    score: Score,
    players: Players,
    progress: Callable[[int, int], None] | None = None,
    costs: Costs = COSTS,
    as_written: bool = False,
) -> Solution:
    """The whole solution of `find_fingering`; for a score with all fingers, their cost."""
    # Equal scores may differ in the hands for which notes are written.
    hands = tuple(note.hands for note in score.notes) if as_written else ()
    problem = score, players, costs, hands
    if problem in _last_solution:
        return _last_solution[problem]
    space = state_space(players)
    stage = first_stage(space)
    steps: list[Backpointers] = []
    notes_played = playable(score, players, as_written)
    for moment in notes_played.moments:
        stage = next_stage(stage, moment.time, moment.strokes, space, costs)
        steps.append(stage.backpointers)
        if progress:
            progress(moment.num_notes, len(score.notes))
    path, _ = backtrack(stage.cost, steps, players.reach.num_fingers)
    fingers = notes_played.ignored | path
    solved = score.with_fingers(n.finger or fingers.get(i) for i, n in enumerate(score.notes))
    notes = solved.notes
    _last_solution.clear()
    _last_solution[problem] = Solution(
        score=solved,
        dropped=tuple(Dropped(notes[i], why) for i, why in sorted(notes_played.reasons.items())),
        ignored=tuple(notes[i] for i in sorted(notes_played.ignored)),
        held=notes_played.held(solved),
        cost=float(stage.cost.min()),
    )
    return _last_solution[problem]


# Dynamic programming


class Backpointers(NamedTuple):
    """The part of a stage that is kept for `backtrack`."""

    strokes: tuple[Stroke, ...]
    fingers: tuple[NDArray[np.uint8], ...]  # right, left: (R, m), (L, m)
    left_before: NDArray[np.unsignedinteger]
    right_before: NDArray[np.unsignedinteger]


@dataclass(frozen=True, eq=False)
class Stage:
    """A moment of the dynamic programme: its states, and the cheapest paths to them.

    strokes             the m sounding notes, in the order of their keys
    cost (R, L)         of the cheapest path to a state of the right and a state of the left hand
    left_before (R', L) the left hand's state before, and
    right_before (R, L) the right hand's, on that path
    """

    time: float
    strokes: tuple[Stroke, ...]
    states: ChordStates
    cost: Array
    left_before: NDArray[np.unsignedinteger]
    right_before: NDArray[np.unsignedinteger]

    @property
    def backpointers(self) -> Backpointers:
        """The part that `backtrack` needs."""
        right, left = self.states.hands
        return Backpointers(
            self.strokes, (right.fingers, left.fingers), self.left_before, self.right_before
        )


state_space = lru_cache(maxsize=8)(StateSpace)


def first_stage(space: StateSpace) -> Stage:
    """The stage before the first note."""
    nothing = np.zeros((1, 1), np.uint8)
    return Stage(-1.0, (), space.initial(), np.zeros((1, 1)), nothing, nothing)


def next_stage(
    before: Stage, time: float, strokes: tuple[Stroke, ...], space: StateSpace, costs: Costs = COSTS
) -> Stage:
    """The stage of the next moment, at `time` [s], in which `strokes` sound."""
    notes = tuple(
        ChordNote(p.key, begins, p.finger, p.hand) if begins else ChordNote(p.key, begins)
        for p in strokes
        for begins in (p.start >= time,)
    )
    states = space.of(notes)
    right, left = states.hands
    old_right, old_left = before.states.hands
    cost = np.full_like(states.forearms, np.inf)
    through = np.empty((len(before.cost), len(left.cost)))  # (R', L) the cheapest over L'
    left_before = np.empty(through.shape, np.min_scalar_type(len(old_left.cost)))
    right_before = np.zeros(cost.shape, np.min_scalar_type(len(old_right.cost)))
    to_right, to_left = finger_change_costs(before.strokes, strokes, time, space.reach, costs)
    seconds = max(time - before.time, RELEASE_TIME)
    change = transition_costs(old_left, left, to_left, seconds, costs)
    for rights, lefts in before.states.splits:
        paths = before.cost[rights, None, lefts] + change[:, lefts]
        _minimise(paths, lefts.start, through[rights], left_before[rights])
    change = transition_costs(old_right, right, to_right, seconds, costs)
    for rights, lefts in states.splits:
        paths = through.T[lefts] + change[rights, None]
        _minimise(paths, 0, cost[rights, lefts], right_before[rights, lefts])
    cost += right.cost[:, None]
    cost += left.cost
    cost += states.forearms
    cost[cost >= INFEASIBLE] = np.inf
    return Stage(time, strokes, states, cost, left_before, right_before)


def _minimise(paths: Array, first: int, cost: Array, before: NDArray[np.unsignedinteger]) -> None:
    """Write the minima over the last axis to `cost`, and `first` plus their places to `before`."""
    paths.min(axis=2, out=cost)
    np.add(paths.argmin(axis=2), first, out=before, casting="unsafe")


def backtrack(
    cost: Array, steps: Sequence[Backpointers], num_fingers: int
) -> tuple[dict[int, Finger], list[tuple[int, int]]]:
    """The path to the minimum of the last costs (R, L).

    Returns index of each played note -> finger, and the states of both hands at each moment.
    """
    fingers: dict[int, Finger] = {}
    states = []
    state = np.unravel_index(cost.argmin(), cost.shape)
    for step in reversed(steps):
        states.append((int(state[0]), int(state[1])))
        for hand, (indices, s) in enumerate(zip(step.fingers, state, strict=True)):
            strokes = step.strokes if hand == 0 else step.strokes[::-1]
            for stroke, index in zip(strokes, indices[s].tolist(), strict=True):
                if index < num_fingers:  # else the other hand plays it
                    fingers |= dict.fromkeys(stroke.notes, Finger(hand, index))
        right, left = state
        right_before = step.right_before[right, left]
        state = (right_before, step.left_before[right_before, left])
    return fingers, states[::-1]
