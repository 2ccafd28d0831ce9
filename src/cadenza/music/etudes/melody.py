"""Melodies over chords."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from cadenza.music.etudes.choice import FORBIDDEN, cheapest, fancy
from cadenza.music.etudes.harmony import Chord
from cadenza.music.etudes.keys import STEPS
from cadenza.music.etudes.sheet import PHRASE, Sheet

# Rhythms of a bar in beats, from the calm to the lively.
_RHYTHMS: dict[int, tuple[tuple[float, ...], ...]] = {
    3: ((3,), (2, 1), (1, 1, 1), (1.5, 0.5, 1), (1, 0.5, 0.5, 1)),
    4: (
        (4,),
        (2, 2),
        (2, 1, 1),
        (1, 1, 2),
        (1, 1, 1, 1),
        (1.5, 0.5, 1, 1),
        (1, 0.5, 0.5, 2),
        (0.5, 0.5, 1, 0.5, 0.5, 1),
    ),
}
_INTERVALS = np.array([60, 0, 20, 50, 90, 140, 180, 200])  # what it costs to move so many degrees
_FANCY = 100


def melody(
    sheet: Sheet, chords: Sequence[Chord], low: int, high: int, slow: bool = False
) -> Iterator[tuple[float, float, int, Chord]]:
    """A note after the other over a chord a bar: (at, length) in steps, degree, chord.

    Bars begin with a tone of the chord; other notes are so, too, or are reached and left by step.

    Args:
        sheet: of the etude.
        chords: a chord a bar.
        low, high: the degrees between which it moves.
        slow: without halves of beats.
    """
    notes = list(_times(sheet, chords, slow))
    degrees = np.arange(low, high + 1)
    far = np.abs(degrees[:, None] - degrees)
    costs, belongs = [], []
    for at, _, chord in notes:
        within = np.array([chord.has(int(degree)) for degree in degrees])
        cost = fancy(sheet.rng, len(degrees), _FANCY)
        if at % sheet.bar == 0:
            cost[~within] = FORBIDDEN
        costs.append(cost)
        belongs.append(within)
    moves = np.where(far < len(_INTERVALS), _INTERVALS[np.minimum(far, STEPS)], FORBIDDEN)
    steps = [
        np.where((was[:, None] & will) | (far == 1), moves, FORBIDDEN)
        for was, will in pairwise(belongs)
    ]
    for (at, length, chord), choice in zip(notes, cheapest(costs, steps), strict=True):
        yield at, length, int(degrees[choice]), chord


def _times(
    sheet: Sheet, chords: Sequence[Chord], slow: bool
) -> Iterator[tuple[float, float, Chord]]:
    """The rhythm of a phrase comes again in all others; a long note ends each."""
    known = _RHYTHMS[sheet.beats]
    if slow:
        known = tuple(rhythm for rhythm in known if all(beats % 1 == 0 for beats in rhythm))
    choices = known[: 2 + sheet.difficulty]
    rhythms = [choices[sheet.pick(*range(len(choices)))] for _ in range(PHRASE)]
    rhythms[-1] = (sheet.beats,)
    for bar, chord in enumerate(chords):
        at = float(bar * sheet.bar)
        for beats in rhythms[bar % PHRASE]:
            yield at, beats * sheet.division, chord
            at += beats * sheet.division
