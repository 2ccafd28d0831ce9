"""Drills for one hand: notes or chords, one after the other, on 25 keys."""

from __future__ import annotations

import numpy as np

from cadenza.music.etudes.keys import STEPS, random_key
from cadenza.music.score import Note, Score

DRILLS = {"notes": 1, "dyads": 2, "triads": 3, "tetrads": 4}
"""Kind -> how many keys are pressed at once."""
_LOWEST, _HIGHEST = 48, 72  # C3 to C5, the keys of the mini keyboard
_BEAT, _LENGTH = 0.75, 0.5  # [s] from one note to the next, and of each
_ACCIDENTALS = 2  # at most
_MAX_STEP = 4  # degrees from one note or chord to the next
_DYADS = (2, 5)  # degrees between the notes of a dyad: a third to a sixth


def drill(kind: str, count: int, rng: np.random.Generator) -> Score:
    """`count` notes or chords of one scale, each different from the one before and near it."""
    key = random_key(rng, _ACCIDENTALS)
    every = map(key.pitch, range(-2 * STEPS, 2 * STEPS + 1))
    scale = [pitch for pitch in every if _LOWEST <= pitch <= _HIGHEST]
    notes: list[Note] = []
    lowest: int | None = None
    for start in _BEAT * np.arange(count):
        intervals = _random_intervals(DRILLS[kind], rng)
        places = np.arange(len(scale) - intervals[-1])
        if lowest is not None:
            step = np.abs(places - lowest)
            places = places[(step > 0) & (step <= _MAX_STEP)]
        lowest = int(rng.choice(places))
        notes += [Note(float(start), start + _LENGTH, scale[lowest + i]) for i in intervals]
    return Score(tuple(notes), title=f"{kind.capitalize()} in {key.name}, {count}")


def _random_intervals(size: int, rng: np.random.Generator) -> list[int]:
    """Degrees of a chord's notes above its lowest: stacked thirds, or an inversion of them."""
    if size == 2:
        return [0, int(rng.integers(*_DYADS, endpoint=True))]
    intervals = np.full(size - 1, 2)
    if size > 2:
        intervals[rng.integers(size - 1)] += rng.integers(2)
    return [0, *np.cumsum(intervals).tolist()]
