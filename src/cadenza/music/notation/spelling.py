"""Keys and the spelling of pitches: C♯ or D♭."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import LOWEST_PITCH, OCTAVE, STEPS, Note

_LINE_OF_FIFTHS = "FCGDAEB"
_FIFTHS = {step: fifths for fifths, step in enumerate(_LINE_OF_FIFTHS, start=-1)}
_SHARP = 7  # fifths from a step to the same with a sharp
_ENHARMONIC = 12  # fifths between two names of a pitch
_CANDIDATES = 3  # likeliest keys; the one with the fewest accidentals is taken
_MAX_SIGNS = 6  # signs of a key signature; rather five flats than seven sharps
_MAX_ALTERED = 2  # sharps or flats of a note
# Of ps13, in which letters count from A, and pitch classes from it.
_BEFORE, _AFTER = 10, 40  # notes that are heard around one
_LETTERS = 7
_NATURALS = np.array([0, 2, 3, 5, 7, 8, 10])
_FIRST_LETTER = np.array([0, 1, 1, 2, 2, 3, 4, 4, 5, 5, 6, 6])  # by pitch class
_LETTER_IN_KEY = np.array([0, 1, 1, 2, 2, 3, 3, 4, 5, 5, 6, 6])  # by semitones above a tonic
# Krumhansl and Kessler 1982: how well pitch classes fit to a key, from its tonic on.
_MAJOR = np.array([6.35, 2.23, 3.48, 2.33, 4.38, 4.09, 2.52, 5.19, 2.39, 3.66, 2.29, 2.88])
_MINOR = np.array([6.33, 2.68, 3.52, 5.38, 2.60, 3.53, 2.54, 4.75, 3.98, 2.69, 3.34, 3.17])
_MIDDLE = 2  # fifths of the middle of a major scale's notes above its key
_FAR = 8  # fifths from there on which a name is strange in the key: in C major, beyond G♭ and A♯


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
    pitches = np.array([note.pitch for note in notes])
    order = np.lexsort((pitches, np.array([note.start for note in notes])))
    spellings = [Spelling("C", 0, 0)] * len(notes)
    for at, spelling in zip(order.tolist(), _ps13(pitches[order]), strict=True):
        spellings[at] = spelling
    line = np.array([spelling.fifths for spelling in spellings])
    keys = _likeliest_keys(notes)[:_CANDIDATES]
    keys = [_nearest(key, float(np.median(line)) - _MIDDLE) for key in keys]
    key = min(keys, key=lambda k: int(((line < k - 1) | (line > k + 5)).sum()))
    if abs(key) > _MAX_SIGNS:
        shift = -_ENHARMONIC if key > 0 else _ENHARMONIC
        key, spellings = key + shift, [_renamed(spelling, shift) for spelling in spellings]
    return key, [_simplified(spelling) for spelling in spellings]


def spelled_in(key: int, spelling: Spelling) -> Spelling:
    """The spelling of a note in a key, by another name if it would be far from the key."""
    away = spelling.fifths - key - _MIDDLE
    return _simplified(_renamed(spelling, _nearest(0, -away))) if abs(away) > _FAR else spelling


def _ps13(pitches: NDArray[np.int_]) -> Iterator[Spelling]:
    """Yield the spellings of MIDI `pitches` (N,), in order of time, by stage 1 of ps13.

    Each pitch class around a note speaks for the letter that the note has in its key.
    """
    pitch = pitches - LOWEST_PITCH
    chroma = pitch % OCTAVE
    cumulative_counts = np.vstack(
        [np.zeros((1, OCTAVE), int), np.eye(OCTAVE, dtype=int)[chroma].cumsum(0)]
    )
    at = np.arange(len(pitch))
    begin, end = np.maximum(at - _BEFORE, 0), np.minimum(at + _AFTER, len(pitch))
    counts = cumulative_counts[end] - cumulative_counts[begin]
    tonics = np.arange(OCTAVE)
    letter_of_tonic = _FIRST_LETTER[chroma[0]] - _LETTER_IN_KEY[(chroma[0] - tonics) % OCTAVE]
    letters = (_LETTER_IN_KEY[(chroma[:, None] - tonics) % OCTAVE] + letter_of_tonic) % _LETTERS
    votes = [(counts * (letters == letter)).sum(1) for letter in range(_LETTERS)]
    letter = np.argmax(votes, axis=0)
    octaves = (pitch // OCTAVE)[:, None] + np.array([0, 1, -1])
    off = np.abs((pitch / OCTAVE)[:, None] - octaves - (letter / _LETTERS)[:, None])
    octave = octaves[at, off.argmin(1)]
    alter = pitch - OCTAVE * octave - _NATURALS[letter]
    for name, sharps, number in zip(letter, alter.tolist(), octave.tolist(), strict=True):
        yield Spelling("ABCDEFG"[name], sharps, number + (name > 1))  # octaves begin with C


def _likeliest_keys(notes: Sequence[Note]) -> list[int]:
    """The key signatures of all keys, by the correlation of their profiles with the notes."""
    lengths = np.zeros(OCTAVE)
    for note in notes:
        lengths[note.pitch % OCTAVE] += note.end - note.start
    profiles = [np.roll(profile, tonic) for profile in (_MAJOR, _MINOR) for tonic in range(OCTAVE)]
    with np.errstate(all="ignore"):  # all pitches may be as frequent
        fit = np.nan_to_num([np.corrcoef(lengths, profile)[0, 1] for profile in profiles])
    tonics = [at % OCTAVE + 3 * (at >= OCTAVE) for at in np.argsort(-fit).tolist()]
    return [(7 * tonic + 5) % OCTAVE - 5 for tonic in tonics]


def _nearest(key: int, fifths: float) -> int:
    """The enharmonic equivalent of a key that is nearest to a place on the line of fifths."""
    return key + _ENHARMONIC * round((fifths - key) / _ENHARMONIC)


def _simplified(spelling: Spelling) -> Spelling:
    """The same pitch with at most two sharps or flats."""
    while abs(spelling.alter) > _MAX_ALTERED:
        spelling = _renamed(spelling, -_ENHARMONIC if spelling.alter > 0 else _ENHARMONIC)
    return spelling


def _renamed(spelling: Spelling, shift: int) -> Spelling:
    """The same pitch, `shift` fifths away."""
    fifths = spelling.fifths + shift
    alter, at = divmod(fifths + 1, _SHARP)
    step = _LINE_OF_FIFTHS[at]
    moved = STEPS.index(step) - STEPS.index(spelling.step)
    # Up by a diminished second, the next step's name; down by one, the one before.
    octave = spelling.octave
    if shift < 0 and moved < 0:
        octave += 1
    elif shift > 0 and moved > 0:
        octave -= 1
    return Spelling(step, alter, octave)
