"""Marks of how loud a part, or one staff of it, is."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction


@dataclass(frozen=True, slots=True)
class Dynamic:
    """Notes have a `velocity` from an `onset` on.

    With `then`, as of fp, it is that of the notes at `onset` alone, and those after have `then`.
    """

    onset: Fraction
    velocity: int
    then: int | None = None


@dataclass(frozen=True, slots=True)
class Sforzato:
    """The notes at `onset` are louder than those around them: sf, sfz, fz, rf and the like."""

    onset: Fraction


@dataclass(frozen=True, slots=True)
class Hairpin:
    """Notes become louder (`step` 1) or softer (-1) little by little from `onset` to `end`.

    The end of a word such as cresc. is None: it goes on up to the next dynamic.
    """

    onset: Fraction
    end: Fraction | None
    step: int
