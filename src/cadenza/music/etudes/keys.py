"""Major and minor keys, and the pitches of their scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from cadenza.music.score import NATURALS, OCTAVE

Form = Literal["natural", "harmonic", "melodic"]
"""The form of a minor scale: nothing, its seventh, or its sixth and seventh are raised."""

STEPS = 7  # degrees of a scale in an octave
_MINOR: dict[Form, tuple[int, ...]] = {
    "natural": (0, 2, 3, 5, 7, 8, 10),
    "harmonic": (0, 2, 3, 5, 7, 8, 11),
    "melodic": (0, 2, 3, 5, 7, 9, 11),
}
_FLATS, _SHARPS = 5, 6  # with more than these, a key has an enharmonic name with fewer
_MAX_FLATS = 6  # of the first of `_NAMES`
# Tonics by fifths, from G-flat major with its six flats. The tonic of a minor key is three fifths
# above that of its relative major key.
_NAMES = (
    *("G-flat", "D-flat", "A-flat", "E-flat", "B-flat", "F"),
    *("C", "G", "D", "A", "E", "B", "F-sharp", "C-sharp", "G-sharp", "D-sharp"),
)
_FIFTHS_TO_MINOR = 3
_FIFTH = 7  # [semitones]
_MIDDLE_C = 60  # tonics lie within six semitones of it


@dataclass(frozen=True)
class Key:
    """A key by its signature: the number of sharps, or of flats if negative."""

    sharps: int
    minor: bool

    @property
    def name(self) -> str:
        """The name of the key, such as "E-flat major"."""
        tonic = _NAMES[self.sharps + _MAX_FLATS + self.minor * _FIFTHS_TO_MINOR]
        return f"{tonic} {'minor' if self.minor else 'major'}"

    @property
    def relative(self) -> Key:
        """The minor key of the same signature, or the major one."""
        return Key(self.sharps, not self.minor)

    def scale(self, form: Form = "natural") -> tuple[int, ...]:
        """The degrees as semitones above the tonic."""
        return _MINOR[form] if self.minor else NATURALS

    def pitch(self, degree: int, form: Form = "natural") -> int:
        """MIDI pitch of a degree of the scale: 0 is the tonic next to middle C, 7 an octave up."""
        fifth = _FIFTH * (self.sharps + self.minor * _FIFTHS_TO_MINOR)
        tonic = _MIDDLE_C + (fifth + OCTAVE // 2) % OCTAVE - OCTAVE // 2
        octave, step = divmod(degree, STEPS)
        return tonic + OCTAVE * octave + self.scale(form)[step]


def random_key(rng: np.random.Generator, max_accidentals: int) -> Key:
    """A major or minor key of at most `max_accidentals`."""
    low, high = -min(max_accidentals, _FLATS), min(max_accidentals, _SHARPS)
    sharps = rng.integers(low, high, endpoint=True)
    return Key(int(sharps), bool(rng.integers(2)))
