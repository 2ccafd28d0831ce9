"""Triads of a key, and the order in which they follow one another."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from cadenza.music.etudes.choice import FORBIDDEN, Costs, cheapest, fancy
from cadenza.music.etudes.keys import STEPS, Form

TONIC, SUPERTONIC, MEDIANT, SUBDOMINANT, DOMINANT, SUBMEDIANT, LEADING = range(STEPS)
_TRIAD = (0, 2, 4)
# Of functional harmony: tonic, then subdominants, then dominants, then tonic.
_FOLLOW = {
    TONIC: (SUPERTONIC, MEDIANT, SUBDOMINANT, DOMINANT, SUBMEDIANT),
    SUPERTONIC: (DOMINANT, LEADING),
    MEDIANT: (SUBDOMINANT, SUBMEDIANT),
    SUBDOMINANT: (TONIC, SUPERTONIC, DOMINANT),
    DOMINANT: (TONIC, SUBMEDIANT),
    SUBMEDIANT: (SUPERTONIC, SUBDOMINANT),
    LEADING: (TONIC,),
}
_RARE = 60  # cost of the mediant and of the leading note's diminished triad
_COMMON = 40  # cost of tonic and dominant, which end phrases
_SAME = 150  # cost of staying on a chord
_FANCY = 100


@dataclass(frozen=True)
class Chord:
    """A triad on a degree of the scale."""

    root: int

    @property
    def form(self) -> Form:
        """Of the minor scale over it: dominants have a leading note."""
        return "melodic" if self.root in (DOMINANT, LEADING) else "natural"

    def has(self, degree: int) -> bool:
        """Whether a degree of the scale, in any octave, is one of its tones."""
        return (degree - self.root) % STEPS in _TRIAD

    def tone(self, index: int) -> int:
        """The degree of its tones from the lowest: 0 the root, 3 an octave above."""
        octave, place = divmod(index, len(_TRIAD))
        return self.root + STEPS * octave + _TRIAD[place]

    def nearest(self, degree: int) -> int:
        """The index of the tone nearest to a degree."""
        around = 3 * ((degree - self.root) // STEPS)
        return min(range(around, around + 4), key=lambda i: abs(self.tone(i) - degree))


@cache
def _follow() -> Costs:
    costs = np.full((STEPS, STEPS), FORBIDDEN)
    for chord, others in _FOLLOW.items():
        costs[chord, list(others)] = 0
        costs[chord, chord] = _SAME
    return costs


def progression(rng: np.random.Generator, phrases: int, length: int) -> list[Chord]:
    """`phrases` of `length` chords: the last ends with V - I, those before it on V or I."""
    count = phrases * length
    fixed = {0: TONIC}
    for end in range(length - 1, count, length):
        half = rng.integers(2) and end < count - 1
        fixed |= {end: DOMINANT} if half else {end - 1: DOMINANT, end: TONIC}
    costs = []
    for i in range(count):
        cost = fancy(rng, STEPS, _FANCY)
        cost[[MEDIANT, LEADING]] += _RARE
        cost[[TONIC, DOMINANT]] += _COMMON
        if i in fixed:
            cost[np.arange(STEPS) != fixed[i]] = FORBIDDEN
        costs.append(cost)
    return [Chord(root) for root in cheapest(costs, [_follow()] * (count - 1))]
