"""Major and minor keys, and the pitches of their scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

Form = Literal["natural", "harmonic", "melodic"]
"""Of a minor scale: what is raised, nothing, its seventh, or its sixth and seventh."""

OCTAVE = 12  # [semitones]
STEPS = 7  # of a scale
_MAJOR = (0, 2, 4, 5, 7, 9, 11)
_MINOR: dict[Form, tuple[int, ...]] = {
    "natural": (0, 2, 3, 5, 7, 8, 10),
    "harmonic": (0, 2, 3, 5, 7, 8, 11),
    "melodic": (0, 2, 3, 5, 7, 9, 11),
}
_FLATS, _SHARPS = 5, 6  # beyond them a key has another name with fewer
# In fifths; G flat major has six flats. A minor tonic is three fifths above that of its relative.
_NAMES = (
    *("G-flat", "D-flat", "A-flat", "E-flat", "B-flat", "F"),
    *("C", "G", "D", "A", "E", "B", "F-sharp", "C-sharp", "G-sharp", "D-sharp"),
)
_FIFTHS_TO_MINOR = 3
_MIDDLE = 60  # the tonic lies within six semitones of middle C


@dataclass(frozen=True)
class Key:
    """A key by its signature: so many sharps, or flats if negative."""

    sharps: int
    minor: bool

    @property
    def name(self) -> str:
        """Such as "E-flat major"."""
        tonic = _NAMES[self.sharps + 6 + self.minor * _FIFTHS_TO_MINOR]
        return f"{tonic} {'minor' if self.minor else 'major'}"

    @property
    def relative(self) -> Key:
        """The minor key of the same signature, or the major one."""
        return Key(self.sharps, not self.minor)

    def scale(self, form: Form = "natural") -> tuple[int, ...]:
        """Semitones above the tonic."""
        return _MINOR[form] if self.minor else _MAJOR

    def pitch(self, degree: int, form: Form = "natural") -> int:
        """MIDI pitch of a degree of the scale: 0 is the tonic next to middle C, 7 an octave up."""
        fifth = 7 * (self.sharps + self.minor * _FIFTHS_TO_MINOR)
        tonic = _MIDDLE + (fifth + OCTAVE // 2) % OCTAVE - OCTAVE // 2
        octave, step = divmod(degree, STEPS)
        return tonic + OCTAVE * octave + self.scale(form)[step]


def draw_key(rng: np.random.Generator, most: int) -> Key:
    """Any major or minor key of at most so many accidentals."""
    sharps = rng.integers(-min(most, _FLATS), min(most, _SHARPS), endpoint=True)
    return Key(int(sharps), bool(rng.integers(2)))
