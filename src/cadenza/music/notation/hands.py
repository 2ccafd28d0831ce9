"""The staff of each note: that of the hand of its finger, or for which it is written, or by pitch.

The upper staff and the lower one are numbered as hands are, `RIGHT` and `LEFT`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadenza.fingers import LEFT, RIGHT
from cadenza.music.score import Note, chords
from cadenza.music.viterbi import cheapest_sequence

_SPLITS = np.arange(43, 80)  # lowest pitch of the right hand, G2 to G5
_MIDDLE = 60  # the usual split, C4
_SPAN = 12  # semitones that a hand plays at once with ease
_TOO_WIDE = 2.0  # cost of each semitone beyond that
_MOVE = 0.15  # cost of moving the split by a semitone
_FAR = 0.01  # cost of each semitone of the split from the middle
_CLOSE = 0.1  # cost of each semitone by which a split leaves less than `_ROOM` between hands
_ROOM = 5  # semitones


def staves(notes: Sequence[Note]) -> list[int]:
    """The staff of each of the `notes`, by start.

    Notes without a finger or a hand are split at a pitch that moves as little as it can while each
    hand spans about an octave at most, found by dynamic programming over chords.
    """
    hands = [(note.finger.hand,) if note.finger else note.hands for note in notes]
    chosen = [hand[0] if hand else RIGHT for hand in hands]
    loose = [i for i, hand in enumerate(hands) if len(hand) != 1]
    if not loose:
        return chosen
    groups = list(chords([notes[i] for i in loose]))
    costs = [_cost(np.array([note.pitch for note in group])) for group in groups]
    move = _MOVE * np.abs(_SPLITS[:, None] - _SPLITS)
    splits = _SPLITS[cheapest_sequence(costs, [move] * (len(groups) - 1))].tolist()
    place = iter(loose)
    for group, split in zip(groups, splits, strict=True):
        for note in group:
            chosen[next(place)] = RIGHT if note.pitch >= split else LEFT
    return chosen


def _cost(pitches: np.ndarray) -> np.ndarray:
    """The cost of each split for a chord."""
    upper = pitches >= _SPLITS[:, None]
    high, low = np.where(upper, pitches, 999), np.where(upper, -999, pitches)
    right = np.where(upper.any(1), pitches.max() - high.min(1), 0)
    left = np.where((~upper).any(1), low.max(1) - pitches.min(), 0)
    wide = np.maximum(right - _SPAN, 0) + np.maximum(left - _SPAN, 0)
    gap = np.abs(pitches - (_SPLITS[:, None] - 0.5)).min(1)
    close = np.maximum(_ROOM / 2 - gap, 0)
    return np.asarray(_TOO_WIDE * wide + _CLOSE * close + _FAR * np.abs(_SPLITS - _MIDDLE))
