"""Keys and the spelling of pitches: C♯ or D♭."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cadenza.music.formats.partitura_modules import partitura_module
from cadenza.music.score import Note

STEPS = "CDEFGAB"
_FIFTHS = {step: fifths for fifths, step in enumerate("FCGDAEB", start=-1)}
_SHARP = 7  # fifths from a step to the same with a sharp
_ENHARMONIC = 12  # fifths between two names of a pitch
_CANDIDATES = 3  # likeliest keys, of which the one with fewest accidentals is taken
_MOST_SIGNS = 6  # of a key signature; rather five flats than seven sharps
_MOST_ALTERED = 2  # sharps or flats of a note
_MIDDLE = 2  # fifths of the middle of a major scale's notes above its key


class Spelling(NamedTuple):
    """The name of a pitch: step, number of sharps (negative for flats) and octave."""

    step: str
    alter: int
    octave: int

    @property
    def fifths(self) -> int:
        """The position on the line of fifths, C being 0."""
        return _FIFTHS[self.step] + _SHARP * self.alter


def spelled(notes: Sequence[Note]) -> tuple[int, list[Spelling]]:
    """The key signature (number of sharps, negative for flats), and the spelling of each note.

    Notes are spelled by the ps13 algorithm (Meredith 2006). Of the three keys whose
    Krumhansl-Kessler profiles correlate best with the notes, the one is taken that needs the fewest
    accidentals. Where the two differ by an enharmonic change, the notes are respelled.
    """
    analysis = partitura_module("musicanalysis")
    fifths_of = partitura_module("utils.music").key_name_to_fifths_mode
    fields = [("onset_beat", "f4"), ("duration_beat", "f4"), ("pitch", "i4")]
    array = np.array([(n.start, n.end - n.start, n.pitch) for n in notes], dtype=fields)
    found = analysis.estimate_spelling(array)
    spellings = [
        Spelling(str(step), int(alter), int(octave))
        for step, alter, octave in zip(found["step"], found["alter"], found["octave"], strict=True)
    ]
    with np.errstate(all="ignore"):  # all pitches may be as frequent
        names = analysis.estimate_key(array, return_sorted_keys=True)
    names = names if isinstance(names, list) else [names]
    line = np.array([spelling.fifths for spelling in spellings])
    keys = [fifths_of(name)[0] for name in names[:_CANDIDATES]]
    keys = [_nearest(key, float(np.median(line)) - _MIDDLE) for key in keys]
    key = min(keys, key=lambda k: int(((line < k - 1) | (line > k + 5)).sum()))
    if abs(key) > _MOST_SIGNS:
        shift = -_ENHARMONIC if key > 0 else _ENHARMONIC
        key, spellings = key + shift, [_renamed(spelling, shift) for spelling in spellings]
    return key, [_simplified(spelling) for spelling in spellings]


def _nearest(key: int, fifths: float) -> int:
    """The enharmonic equivalent of a key that is nearest to a place on the line of fifths."""
    return key + _ENHARMONIC * round((fifths - key) / _ENHARMONIC)


def _simplified(spelling: Spelling) -> Spelling:
    """The same pitch with at most two sharps or flats."""
    while abs(spelling.alter) > _MOST_ALTERED:
        spelling = _renamed(spelling, -_ENHARMONIC if spelling.alter > 0 else _ENHARMONIC)
    return spelling


def _renamed(spelling: Spelling, shift: int) -> Spelling:
    """The same pitch, `shift` fifths away."""
    fifths = spelling.fifths + shift
    alter, at = divmod(fifths + 1, _SHARP)
    step = "FCGDAEB"[at]
    moved = STEPS.index(step) - STEPS.index(spelling.step)
    # Up by a diminished second, the next step's name; down by one, the one before.
    octave = spelling.octave
    if shift < 0 and moved < 0:
        octave += 1
    elif shift > 0 and moved > 0:
        octave -= 1
    return Spelling(step, alter, octave)
