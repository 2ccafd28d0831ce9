"""The difficulty of a score for two hands, as a grade from 1 to 10.

With each grade the odds of an error, those of 1 - F1, are `ODDS` times as high. The grade is a sum
over `Features` of the score and its fingers, each on a logarithmic scale and with a weight of zero
or more: more of a feature is never easier. `tools/fit_difficulty.py` has fitted the weights to the
planner's F1; docs/difficulty.md describes the data and the fit.
"""

from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.fingering.players import Players
from cadenza.fingering.search import find_fingering
from cadenza.fingers import NO_FINGER, SIDES
from cadenza.hands.reach import Array
from cadenza.music.arrangement import EASIEST, HARDEST
from cadenza.music.score import MIDI_PITCHES, Score, chords, is_black

ODDS = 1.6

_FINGER_TO_FINGER = 12 / 7  # [semitones] between fingers at rest: they lie on white keys
_LEISURE = 0.3  # [s] in which a finger gets to another key without hurry
_CROSSING_TIME = 0.5  # [s] within which fingers cross, rather than the hand moves
_BLACK = np.array([is_black(pitch) for pitch in MIDI_PITCHES])


@dataclass(frozen=True)
class Features:
    """Features that make a score hard for two hands; all are 0 or more.

    Notes without fingers count for no hand.
    """

    notes: float  # notes a second
    chords: float  # notes that begin together, beyond the first
    polyphony: float  # keys down at once while any is, beyond the first
    spread: float  # span of the keys that a hand strikes at once, for each note [semitones]
    travel: float  # speed of both hands together along the keyboard [semitones / s]
    hurry: float  # share of notes whose finger comes from another key without time to move
    crossings: float  # fingers that pass over or under one another [1 / s]
    black: float  # share of notes on black keys


@dataclass(frozen=True)
class DifficultyModel:
    """Grades: a constant, and a weight for the logarithm of 1 + each feature."""

    constant: float
    weights: Features

    def grade(self, features: Features) -> float:
        """The grade of these features, from `EASIEST` to `HARDEST`."""
        grade = self.constant + float(np.dot(astuple(self.weights), np.log1p(astuple(features))))
        return min(max(grade, float(EASIEST)), float(HARDEST))


FITTED = DifficultyModel(
    constant=-0.7,
    weights=Features(
        notes=0.7,
        chords=0.2,
        polyphony=1.0,
        spread=0.8,
        travel=1.0,
        hurry=3.5,
        crossings=1.0,
        black=2.7,
    ),
)
"""The model that `tools/fit_difficulty.py` has fitted."""


def grade(score: Score, players: Players | None = None) -> float:
    """The difficulty of `score`, from 1 to 10.

    The fingers are those that the planner finds for `players` or, without these, those of the
    score. Raises CadenzaError if there are no notes, or no fingers and no players.
    """
    if players is not None:
        score, _ = find_fingering(score.without_fingers(), players)
    elif not score.has_fingering:
        raise CadenzaError(f"{score.title or 'score'}: without fingers; say who plays")
    return FITTED.grade(features_of(score))


def features_of(score: Score) -> Features:
    """The features of a score with fingers, in linear time; raises CadenzaError without notes."""
    if not score.notes:
        raise CadenzaError(f"{score.title or 'score'}: without notes, nothing is hard or easy")
    start = np.array([note.start for note in score.notes])
    end = np.array([note.end for note in score.notes])
    pitch = np.array([note.pitch for note in score.notes])
    fingers = [note.finger for note in score.notes]
    side = np.array([finger.hand if finger else NO_FINGER for finger in fingers])
    place = np.array([finger.index if finger else NO_FINGER for finger in fingers])
    seconds = float(end.max() - start.min())
    sizes = [len(chord) for chord in chords(score.notes)]
    moment = np.repeat(np.arange(len(sizes)), sizes)
    spread = travel = crossings = 0.0
    for hand in range(len(SIDES)):
        of_hand = side == hand
        if of_hand.any():
            outward = 1 - 2 * hand  # to the little finger
            places = pitch[of_hand] - outward * _FINGER_TO_FINGER * place[of_hand]
            spread += _spread(moment[of_hand], pitch[of_hand])
            travel += _travel(moment[of_hand], places)
            crossings += _crossings(
                start[of_hand], moment[of_hand], outward * pitch[of_hand], place[of_hand]
            )
    return Features(
        notes=len(start) / seconds,
        chords=len(start) / len(sizes) - 1,
        polyphony=_polyphony(start, end),
        spread=spread / len(start),
        travel=travel / seconds,
        hurry=_hurry(start, end, pitch, len(SIDES) * place + side) / len(start),
        crossings=crossings / seconds,
        black=float(_BLACK[pitch].mean()),
    )


def _polyphony(start: Array, end: Array) -> float:
    """Mean number of notes while any sounds, minus one."""
    times = np.concatenate([start, end])
    changes = np.repeat([1, -1], len(start))
    order = np.lexsort((changes, times))
    sounding = np.cumsum(changes[order])[:-1]
    seconds = np.diff(times[order])
    return float(sounding @ seconds / seconds[sounding > 0].sum()) - 1


def _first_notes(moment: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.flatnonzero(np.diff(moment, prepend=-1))


def _spread(moment: NDArray[np.intp], pitch: Array) -> float:
    """Sum over moments of the span between the outer keys of one hand [semitones]."""
    first = _first_notes(moment)
    return float((np.maximum.reduceat(pitch, first) - np.minimum.reduceat(pitch, first)).sum())


def _travel(moment: NDArray[np.intp], place: Array) -> float:
    """Distance that one hand travels [semitones], at the means of the places of its fingers."""
    first = _first_notes(moment)
    mean = np.add.reduceat(place, first) / np.diff(first, append=len(place))
    return float(np.abs(np.diff(mean)).sum())


def _crossings(
    start: Array, moment: NDArray[np.intp], outward: Array, place: NDArray[np.intp]
) -> float:
    """Number of times that a hand moves outwards with a more inner finger, or the reverse."""
    soon = (np.diff(moment) > 0) & (np.diff(start) < _CROSSING_TIME)
    return float((soon & (np.diff(outward) * np.diff(place) < 0)).sum())


def _hurry(start: Array, end: Array, pitch: Array, finger: NDArray[np.intp]) -> float:
    """Sum over notes: 1 if the finger has just left another key, down to 0 if it had time."""
    order = np.lexsort((start, finger))
    start, end, pitch, finger = start[order], end[order], pitch[order], finger[order]
    another = (np.diff(finger) == 0) & (np.diff(pitch) != 0) & (finger[1:] >= 0)
    gap = start[1:] - end[:-1]
    return float((another * np.clip(1 - gap / _LEISURE, 0, 1)).sum())
