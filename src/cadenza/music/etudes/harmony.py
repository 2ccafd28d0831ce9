"""Keys and triads, chord progressions, and the rules of strict voice leading as costs.

Costs are whole numbers, so that the same sequence is chosen on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import NATURALS, OCTAVE
from cadenza.music.viterbi import cheapest_sequence

Form = Literal["natural", "harmonic", "melodic"]
"""The form of a minor scale: nothing, its seventh, or its sixth and seventh are raised."""

STEPS = 7  # degrees of a scale in an octave
_MINOR: dict[Form, tuple[int, ...]] = {
    "natural": (0, 2, 3, 5, 7, 8, 10),
    "harmonic": (0, 2, 3, 5, 7, 8, 11),
    "melodic": (0, 2, 3, 5, 7, 9, 11),
}
_FLATS, _SHARPS = 5, 6  # with more than these, a key has an enharmonic name with fewer
_MAX_FLATS = 6  # flats of the first of `_NAMES`
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


Costs = NDArray[np.int64]
Pitches = NDArray[np.int64]
FORBIDDEN = 1_000_000  # cost of breaking a rule: more than all other costs of an etude together
_TRITONE, _AUGMENTED_SECOND = 6, 3  # [semitones]
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
    is_same_interval = (high - low) % OCTAVE == (then_high - then_low) % OCTAVE
    moves = (low != then_low) & (high != then_high)
    return moves & is_same_interval & is_perfect(low, high)


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


TONIC, SUPERTONIC, MEDIANT, SUBDOMINANT, DOMINANT, SUBMEDIANT, LEADING = range(STEPS)
_TRIAD = (0, 2, 4)
# Functional harmony: from the tonic to subdominants, to dominants, to the tonic.
_SUCCESSORS = {
    TONIC: (SUPERTONIC, MEDIANT, SUBDOMINANT, DOMINANT, SUBMEDIANT),
    SUPERTONIC: (DOMINANT, LEADING),
    MEDIANT: (SUBDOMINANT, SUBMEDIANT),
    SUBDOMINANT: (TONIC, SUPERTONIC, DOMINANT),
    DOMINANT: (TONIC, SUBMEDIANT),
    SUBMEDIANT: (SUPERTONIC, SUBDOMINANT),
    LEADING: (TONIC,),
}
_RARE = 60  # additional cost of the mediant and of the leading note's diminished triad
_COMMON = 40  # additional cost of tonic and dominant, which end phrases
_SAME = 150  # cost of staying on a chord
_RANDOM = 100  # largest random cost of a chord


@dataclass(frozen=True)
class Triad:
    """A triad on a degree of the scale."""

    root: int

    @property
    def form(self) -> Form:
        """The form of the minor scale over it: dominants have a leading note."""
        return "melodic" if self.root in (DOMINANT, LEADING) else "natural"

    def has(self, degree: int) -> bool:
        """Whether a degree of the scale, in any octave, is one of its tones."""
        return (degree - self.root) % STEPS in _TRIAD

    def tone(self, index: int) -> int:
        """The degree of one of its tones: `index` 0 is the root, 3 the root an octave above."""
        octave, place = divmod(index, len(_TRIAD))
        return self.root + STEPS * octave + _TRIAD[place]

    def nearest(self, degree: int) -> int:
        """The index of the tone nearest to a degree."""
        below = len(_TRIAD) * ((degree - self.root) // STEPS)
        return min(range(below, below + len(_TRIAD) + 1), key=lambda i: abs(self.tone(i) - degree))


@cache
def _transition_costs() -> Costs:
    """(7, 7) costs of the progression from each chord to each next."""
    costs = np.full((STEPS, STEPS), FORBIDDEN)
    for chord, successors in _SUCCESSORS.items():
        costs[chord, list(successors)] = 0
        costs[chord, chord] = _SAME
    return costs


def progression(rng: np.random.Generator, phrases: int, length: int) -> list[Triad]:
    """A progression of phrases of `length` chords; the last ends with V - I, others on V or I."""
    count = phrases * length
    fixed = {0: TONIC}
    for end in range(length - 1, count, length):
        half = rng.integers(2) and end < count - 1
        fixed |= {end: DOMINANT} if half else {end - 1: DOMINANT, end: TONIC}
    costs = []
    for i in range(count):
        cost = random_costs(rng, STEPS, _RANDOM)
        cost[[MEDIANT, LEADING]] += _RARE
        cost[[TONIC, DOMINANT]] += _COMMON
        if i in fixed:
            cost[np.arange(STEPS) != fixed[i]] = FORBIDDEN
        costs.append(cost)
    return [Triad(root) for root in cheapest_sequence(costs, [_transition_costs()] * (count - 1))]
