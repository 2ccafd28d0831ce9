"""The likeness of notes to a melody.

A melody is sung or played alone, moves mostly by steps, in rhythms that differ from bar to bar, and
in the range of a voice. The weights were chosen on songs for bands, those of the benchmark up to
band-1024.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import CHORD_TOLERANCE, OCTAVE, Note, chords

Array = NDArray[np.float64]

_CALLED_MELODY = re.compile(
    r"melod|vocal|\bvox\b|voice|lead|\bsing|\bsang\b|\bsolo|\btune\b|theme|cantus|soprano|\bair\b"
    r"|\bgesang|\bvoix|\bvoz\b|\bcanto\b|\bmain\b"
)
_CALLED_OTHERWISE = re.compile(
    r"chord|\bpad|rhythm|comp\b|string|back|accomp|\barp|organ|harmon|\bbv|choir|chorus|riff|stab"
    r"|section|\bbass\b|drum|perc|second|2nd|\b2\b|doubl|unison|octave|sequen|pick|\bfills?\b|hook"
)
_SOLO = re.compile(
    r"voice|choir aahs|lead|flute|oboe|clarinet|sax|violin|fiddle|harmonica|recorder|whistle"
    r"|trumpet|trombone|horn|ocarina|soprano|alto|tenor|cornet"
)
_ACCOMPANIMENT = re.compile(
    r"pad|ensemble|section|synth strings|orchestra hit|timpani|muted electric"
)
CALLED_BASS = re.compile(
    r"\bbass(?!oon|et| clarinet| drum| and lead)|contrabass|\btuba\b|\bcello|violoncello"
)
"""Matches names of parts and instruments, in small letters, that play the bass."""

_NAME, _INSTRUMENT, _BASS = 3.0, 1.0, 6.0
_MONOPHONY, _STEPS, _VARIETY, _RHYTHM, _LOUD, _HIGH = 3.0, 1.5, 1.5, 1.0, 0.5, 1.5
_FAST, _EVEN, _OSTINATO = 0.5, 1.5, 3.0
_LEGATO = 0.1  # [s] for which the notes of a melody overlap
_STEP = 4  # [semitones] a step, or a small leap
_SAME_GAP = 0.08  # [s] between gaps that are felt as different
_SINGABLE = 4.0  # [1/s] notes
_VOICE, _COMFORTABLE = 69.0, 10.0  # the middle of the melodies' range, and its half [semitones]
_USUAL, _LOUDER = 0.6, 20.0  # share above which repetition counts; velocity that is worth one
_PITCHES = 4, 10  # different pitches: few, and many
_GAPS = 6  # different gaps that are many
_TOGETHER = 0.8  # share of the notes of two lines that begin together, if one follows the other
_PHRASE = 1.0  # [s] between the notes of a phrase


class Line(NamedTuple):
    """The highest notes of the N chords of a part, (N,) each."""

    start: Array
    pitch: Array
    single: Array  # 1 for notes that begin alone
    overlapped: Array  # 1 for notes that sound on when the next begins
    velocity: Array
    again: Array  # 1 for notes that begin where a note begins in the bar before, too

    @classmethod
    def of(cls, notes: Sequence[Note], bars: Array) -> Line:
        """The line of a part's notes; `bars` (B,) are the times at which bars begin [s]."""
        groups = list(chords(notes))
        start = np.array([chord[0].start for chord in groups])
        end = np.array([min(note.end for note in chord) for chord in groups])
        return cls(
            start,
            np.array([max(note.pitch for note in chord) for chord in groups], float),
            np.array([len(chord) == 1 for chord in groups], float),
            np.append(end[:-1] > start[1:] + _LEGATO, False).astype(float),
            np.array([max(note.velocity for note in chord) for chord in groups], float),
            _repeated(start, bars),
        )

    def between(self, begin: float, end: float) -> Line:
        """The notes that begin from `begin` to `end` [s]."""
        rows = slice(*np.searchsorted(self.start, [begin, end]))
        return Line._make(values[rows] for values in self)

    def follows(self, other: Line) -> bool:
        """Whether these notes begin where those of a longer line do, as a second voice does."""
        if len(other.start) <= len(self.start):
            return False
        during = other.start[_near(other.start, self.start, _PHRASE)]
        together = _near(self.start, other.start, CHORD_TOLERANCE).sum()
        return bool(together > _TOGETHER * max(len(self.start), len(during)))

    def likeness(self, loudness: float) -> float:
        """How much these notes are like a melody; `loudness` is the mean velocity of the song."""
        few, many = _PITCHES
        likeness = _MONOPHONY * (self.single - 0.5 * self.overlapped).mean()
        likeness += _VARIETY * min((len(np.unique(self.pitch)) - few) / (many - few), 1.0)
        likeness += _LOUD * (self.velocity.mean() - loudness) / _LOUDER
        likeness -= _OSTINATO * _excess(self.again.mean())
        beyond = abs(float(np.median(self.pitch)) - _VOICE) - _COMFORTABLE
        likeness -= _HIGH * max(beyond, 0.0) / OCTAVE
        return float(likeness) + (self._motion() if len(self.start) > 1 else 0.0)

    def _motion(self) -> float:
        """How much these notes move like a melody."""
        gaps, steps = np.diff(self.start), np.abs(np.diff(self.pitch))
        _, counts = np.unique(np.round(gaps / _SAME_GAP), return_counts=True)
        density = len(gaps) / max(self.start[-1] - self.start[0], 1.0)
        likeness = _STEPS * (steps <= _STEP).mean() + _RHYTHM * min(len(counts) / _GAPS, 1.0)
        likeness -= _EVEN * _excess(counts.max() / len(gaps))
        return float(likeness - _FAST * max(density - _SINGABLE, 0.0))


def likeness_by_name(name: str, instrument: str) -> float:
    """The likeness of a part to a melody by its name and instrument."""
    instrument, name = instrument.lower(), name.lower()
    if name == instrument:  # it has no name of its own
        name = ""
    likeness = _NAME * (bool(_CALLED_MELODY.search(name)) - bool(_CALLED_OTHERWISE.search(name)))
    likeness += _INSTRUMENT * bool(_SOLO.search(instrument))
    likeness -= _INSTRUMENT * bool(_ACCOMPANIMENT.search(instrument))
    return likeness - _BASS * bool(CALLED_BASS.search(f"{name} {instrument}"))


def _excess(share: float) -> float:
    """The excess of a share over the usual one, from 0 to 1."""
    return max(share - _USUAL, 0.0) / (1 - _USUAL)


def _near(times: Array, sorted_times: Array, seconds: float) -> NDArray[np.bool_]:
    """Whether each of some times (N,) is near any of the `sorted_times`."""
    index = np.minimum(np.searchsorted(sorted_times, times - seconds), len(sorted_times) - 1)
    return np.abs(sorted_times[index] - times) <= seconds


def _repeated(start: Array, bars: Array) -> Array:
    """(N,) 1 for notes that begin one bar after another of the same part begins, else 0."""
    if len(bars) < 2:
        return np.zeros(len(start))
    bar = np.clip(np.searchsorted(bars, start + CHORD_TOLERANCE, side="right") - 1, 1, None)
    previous = start - (bars[bar] - bars[bar - 1])
    return _near(previous, start, CHORD_TOLERANCE).astype(float)
