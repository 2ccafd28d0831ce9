"""Marks for all parts that change how fast the music goes, or how its beats are divided."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from fractions import Fraction

from cadenza.music.signs.conventions import FERMATA


@dataclass(frozen=True, slots=True)
class Tempo:
    """A tempo mark: a quarter lasts `seconds` [s] from an `onset` on."""

    onset: Fraction
    seconds: float


class Change(Enum):
    """A change of tempo in words."""

    RITARDANDO = auto()
    """Slower little by little: rit., rall., allargando, and the like."""
    ACCELERANDO = auto()
    """Faster little by little: accel., stringendo."""
    MENO_MOSSO = auto()
    """Slower at once: meno mosso, ritenuto."""
    PIU_MOSSO = auto()
    """Faster at once."""
    A_TEMPO = auto()
    """The tempo before the last change."""
    TEMPO_PRIMO = auto()
    """The tempo at the beginning."""


@dataclass(frozen=True, slots=True)
class TempoWord:
    """The tempo changes at `onset`.

    One that changes little by little goes on until `end`, if the score says how far it goes, as a
    line does; else up to the next mark of a tempo.
    """

    onset: Fraction
    change: Change
    end: Fraction | None = None


@dataclass(frozen=True, slots=True)
class Modulation:
    """A metric modulation: a quarter lasts `slower` times as long from `onset` on as before."""

    onset: Fraction
    slower: Fraction


@dataclass(frozen=True, slots=True)
class Fermata:
    """A fermata over a note, a chord or a rest from `onset` to `end`: all parts wait.

    The note is `factor` times as long. One over a barline has its onset at its end.
    """

    onset: Fraction
    end: Fraction
    factor: float = FERMATA


@dataclass(frozen=True, slots=True)
class Caesura:
    """Two strokes at `onset`: what sounds ends there, and all parts pause."""

    onset: Fraction


TempoMark = Tempo | TempoWord | Modulation | Fermata | Caesura


def says_tempo(mark: TempoMark) -> bool:
    """Whether a mark gives a tempo, and not a way to play: a change by degrees, or a wait."""
    if isinstance(mark, TempoWord):
        return mark.change is Change.TEMPO_PRIMO
    return isinstance(mark, Tempo | Modulation)


@dataclass(frozen=True, slots=True)
class Swing:
    """Two notes of a `unit` last as `first : second` from an `onset` on.

    The unit is in quarters: 1/2 for eighths, 1/4 for sixteenths. With 1 : 1 notes are straight.
    `beat` is any place where the first of two may stand, such as the beginning of a full bar.
    """

    onset: Fraction
    first: int = 2
    second: int = 1
    unit: Fraction = Fraction(1, 2)
    beat: Fraction = Fraction(0)
