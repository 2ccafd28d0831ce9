"""Voice leading: the rules of strict writing, as costs.

Costs are whole numbers, so that the same sequence is chosen on every machine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import OCTAVE

Costs = NDArray[np.int64]
Pitches = NDArray[np.int64]
FORBIDDEN = 1_000_000
"""Cost of breaking a rule: more than all other costs of an etude together."""
_FIFTH, _TRITONE, _AUGMENTED_SECOND = 7, 6, 3  # [semitones]
_CONSONANCES = (0, 3, 4, 7, 8, 9)  # [semitones] unison, thirds, fifth, sixths


def random_costs(rng: np.random.Generator, count: int, largest: int) -> Costs:
    """(count,) random costs from 0 to `largest`, so that etudes differ."""
    return rng.integers(0, largest, count, endpoint=True)


def is_perfect(low: Pitches, high: Pitches) -> NDArray[np.bool_]:
    """Whether intervals are perfect: a unison, fifth or octave, simple or compound."""
    interval = (high - low) % OCTAVE
    return (interval == 0) | (interval == _FIFTH)


def is_consonant(low: Pitches, high: Pitches) -> NDArray[np.bool_]:
    """Whether intervals are consonant: a unison, third, fifth or sixth, simple or compound."""
    return np.isin((high - low) % OCTAVE, _CONSONANCES)


def are_parallel(
    low: Pitches, high: Pitches, then_low: Pitches, then_high: Pitches
) -> NDArray[np.bool_]:
    """Whether two voices move in parallel fifths or octaves."""
    same = (high - low) % OCTAVE == (then_high - then_low) % OCTAVE
    moves = (low != then_low) & (high != then_high)
    return moves & same & is_perfect(low, high)


def are_hidden(
    low: Pitches, high: Pitches, then_low: Pitches, then_high: Pitches
) -> NDArray[np.bool_]:
    """Whether two voices move in hidden fifths or octaves: in similar motion to them."""
    similar = (then_low - low) * (then_high - high) > 0
    return similar & is_perfect(then_low, then_high)


def is_awkward_leap(degrees: Pitches, semitones: Pitches) -> NDArray[np.bool_]:
    """Whether a voice moves by a tritone or an augmented second."""
    second = (np.abs(degrees) == 1) & (np.abs(semitones) == _AUGMENTED_SECOND)
    return second | (np.abs(semitones) == _TRITONE)
