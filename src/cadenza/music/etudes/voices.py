"""What voices may not do: the rules of strict writing, for arrays of pitches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.music.etudes.keys import OCTAVE

Pitches = NDArray[np.int64]
_FIFTH, _TRITONE, _AUGMENTED_SECOND = 7, 6, 3  # [semitones]


def is_perfect(low: Pitches, high: Pitches) -> NDArray[np.bool_]:
    """Whether they are a fifth, an octave or a unison apart, or octaves more."""
    interval = (high - low) % OCTAVE
    return (interval == 0) | (interval == _FIFTH)


def is_consonant(low: Pitches, high: Pitches) -> NDArray[np.bool_]:
    """Whether they are a unison, third, fifth or sixth apart, or octaves more."""
    return np.isin((high - low) % OCTAVE, (0, 3, 4, 7, 8, 9))


def are_parallel(
    low: Pitches, high: Pitches, then_low: Pitches, then_high: Pitches
) -> NDArray[np.bool_]:
    """Whether two voices move from one fifth or octave to another."""
    same = (high - low) % OCTAVE == (then_high - then_low) % OCTAVE
    moves = (low != then_low) & (high != then_high)
    return moves & same & is_perfect(low, high)


def are_hidden(
    low: Pitches, high: Pitches, then_low: Pitches, then_high: Pitches
) -> NDArray[np.bool_]:
    """Whether two voices move in one direction to a fifth or an octave."""
    similar = (then_low - low) * (then_high - high) > 0
    return similar & is_perfect(then_low, then_high)


def is_awkward(degrees: Pitches, semitones: Pitches) -> NDArray[np.bool_]:
    """Whether a voice that moves so far, counted in both, leaps a tritone or augmented second."""
    second = (np.abs(degrees) == 1) & (np.abs(semitones) == _AUGMENTED_SECOND)
    return second | (np.abs(semitones) == _TRITONE)
