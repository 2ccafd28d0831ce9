"""Metronome marks: a note for a number, or for other notes."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from fractions import Fraction
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import ZERO, length_of, number

_SLOWEST, _FASTEST = 1, 10_000  # quarters a minute
_PER_MINUTE = re.compile(r"\d{1,5}([.,]\d{1,3})?")
_LARGEST_TUPLET = Fraction(64)  # notes


def is_possible(speed: Fraction) -> bool:
    """Whether music may have a tempo, in quarters a minute."""
    return _SLOWEST <= speed <= _FASTEST


@dataclass(slots=True)
class Metronome:
    """What a metronome mark says: notes, by their lengths [quarters], and what they are equal to.

    That is a number a minute, or the lengths of notes `after`.
    """

    before: list[Fraction] = field(default_factory=list)
    after: list[Fraction] = field(default_factory=list)
    per_minute: Fraction = ZERO

    @property
    def quarters_a_minute(self) -> Fraction | None:
        """The tempo, if a number gives one that may be."""
        speed = sum(self.before, ZERO) * self.per_minute
        return speed if is_possible(speed) else None

    @property
    def slower(self) -> Fraction | None:
        """How many times longer notes are now, if those on the left were as long as those on the
        right are; None if the mark says nothing like it."""
        old, new = sum(self.before, ZERO), sum(self.after, ZERO)
        return old / new if old and new else None

    @property
    def swing(self) -> tuple[int, int] | None:
        """How two equal notes share their time, where the mark shows two others in their place."""
        is_pair = len(self.before) == len(self.after) == 2
        if not is_pair or self.slower != 1 or self.before[0] != self.before[1]:
            return None
        share = self.after[0] / sum(self.after)
        return share.numerator, share.denominator - share.numerator


def metronome_of(mark: Element) -> Metronome:
    """Reads a metronome mark."""
    found = Metronome()
    notes, unit, tuplet = found.before, ZERO, Fraction(1)
    for each in mark:
        text = (each.text or "").strip()
        if each.tag == "beat-unit":
            notes, unit = found.after if found.before else found.before, length_of(text, dots=0)
            notes.append(unit)
        elif each.tag == "beat-unit-dot" and notes:
            unit /= 2
            notes[-1] += unit
        elif each.tag == "beat-unit-tied" and notes:
            notes[-1] += _length(each, "beat-unit")
        elif each.tag == "metronome-relation":
            notes = found.after
        elif each.tag == "metronome-note":
            bracket = each.find("metronome-tuplet")
            kind = None if bracket is None else bracket.get("type")
            if bracket is not None and kind == "start":
                tuplet = _shortened(bracket)
            notes.append(_length(each, "metronome-type") * tuplet)
            if kind == "stop":
                tuplet = Fraction(1)
        elif each.tag == "per-minute" and (said := _PER_MINUTE.search(text)):
            found.per_minute = number(said[0].replace(",", "."))
    return found


def _length(note: Element, tag: str) -> Fraction:
    """The length of a note in a mark, with its dots [quarters]."""
    dots = sum(each.tag in ("beat-unit-dot", "metronome-dot") for each in note)
    return length_of(note.findtext(tag, ""), dots)


def _shortened(tuplet: Element) -> Fraction:
    """What the lengths of the notes in a tuplet are multiplied by."""
    actual, normal = (
        min(max(number(tuplet.findtext(tag)), Fraction(1)), _LARGEST_TUPLET)
        for tag in ("actual-notes", "normal-notes")
    )
    return normal / actual
