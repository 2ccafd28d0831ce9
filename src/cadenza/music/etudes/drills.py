"""Drills for one hand: notes or chords, one after the other, on 25 keys."""

from __future__ import annotations

import numpy as np

from cadenza.music.etudes.keys import STEPS, draw_key
from cadenza.music.score import Note, Score

DRILLS = {"notes": 1, "dyads": 2, "triads": 3, "tetrads": 4}
"""Kind -> how many keys are pressed at once."""
_LOWEST, _HIGHEST = 48, 72  # C to C
_BEAT, _HELD = 0.75, 0.5  # [s] from one to the next, that each lasts
_ACCIDENTALS = 2  # at most
_FARTHEST = 4  # degrees from one to the next
_DYADS = (2, 5)  # degrees from the lower to the higher note: a third to a sixth


def drill(kind: str, count: int, rng: np.random.Generator) -> Score:
    """So many notes or chords of one scale, each another one than before and near to it."""
    key = draw_key(rng, _ACCIDENTALS)
    every = map(key.pitch, range(-2 * STEPS, 2 * STEPS + 1))
    scale = [pitch for pitch in every if _LOWEST <= pitch <= _HIGHEST]
    notes: list[Note] = []
    lowest: int | None = None
    for start in _BEAT * np.arange(count):
        above = _above(DRILLS[kind], rng)
        places = np.arange(len(scale) - above[-1])
        if lowest is not None:
            far = np.abs(places - lowest)
            places = places[(far > 0) & (far <= _FARTHEST)]
        lowest = int(rng.choice(places))
        notes += [Note(float(start), start + _HELD, scale[lowest + degrees]) for degrees in above]
    return Score(tuple(notes), title=f"{kind.capitalize()} in {key.name}, {count}")


def _above(size: int, rng: np.random.Generator) -> list[int]:
    """Degrees of a chord's notes above its lowest: stacked thirds, or an inversion of them."""
    if size == 2:
        return [0, int(rng.integers(*_DYADS, endpoint=True))]
    intervals = np.full(size - 1, 2)
    if size > 2:
        intervals[rng.integers(size - 1)] += rng.integers(2)
    return [0, *np.cumsum(intervals).tolist()]
