"""Tempos: those for playback, metronome marks, words, fermatas, caesuras and swing."""

import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import (
    NOTE_VALUES,
    ZERO,
    Placed,
    ends_of_lines,
    length_of,
    number,
)
from cadenza.music.signs import CHORALE_FERMATA, FERMATA, LONG_FERMATA, SHORT_FERMATA
from cadenza.music.signs.tempo_map import (
    Caesura,
    Fermata,
    Modulation,
    Swing,
    Tempo,
    TempoMark,
    TempoWord,
)
from cadenza.music.signs.words import swing, tempo_change, usual_tempo

_SLOWEST, _FASTEST = 1, 10_000  # quarters a minute
_PER_MINUTE = re.compile("[0-9]{1,5}([.,][0-9]{1,3})?")
_MAX_TUPLET = Fraction(64)  # notes
_EIGHTH = NOTE_VALUES["eighth"]
_MINUTE = 60  # seconds
_FERMATAS = {
    **dict.fromkeys(("angled", "double-angled"), SHORT_FERMATA),
    **dict.fromkeys(("square", "double-square"), LONG_FERMATA),
}
_MIN_LINES = 4  # of a chorale
_LINE = 1.5, 6.0  # bars of its lines, in the mean
_MAX_SWING = 16  # times as long as the other note of a pair


class TempoMarks:
    """The marks in all parts that change the tempo; where they differ, the first part counts.

    A metronome mark counts where there is no tempo for playback. `marks` and `swings` have their
    places in quarters. Without a tempo of either kind, words such as "Andante" have their usual
    ones. Added to `counts` are those "usual" ones, tempos for playback that are "impossible", and
    metronome marks that are "unclear", as they give none. `begins` is as `timeline` returns it.
    """

    def __init__(
        self,
        parts: Sequence[Sequence[Placed]],
        begins: Sequence[Fraction],
        counts: Counter[str],
    ) -> None:
        self.marks: list[TempoMark] = []
        self.swings: list[Swing] = []
        self._begins, self._counts = begins, counts
        self._for_playback: dict[Fraction, Fraction] = {}  # quarters a minute
        self._metronome: dict[Fraction, Fraction] = {}
        self._usual: dict[Fraction, Fraction] = {}
        fermatas: list[Fermata] = []
        for part in reversed(parts):
            end_of_line = ends_of_lines(part)
            for placed in part:
                if placed.element.tag in ("direction", "sound"):
                    self._read_direction(placed, end_of_line(placed))
                elif placed.element.tag in ("note", "barline"):
                    fermatas += _fermatas(placed)
                    if placed.element.find("notations/articulations/caesura") is not None:
                        self.marks.append(Caesura(placed.quarter + placed.duration))
        is_chorale = self._is_chorale([fermata.end for fermata in fermatas])
        for fermata in fermatas:
            if is_chorale and fermata.factor == FERMATA:
                fermata = replace(fermata, factor=CHORALE_FERMATA)
            self.marks.append(fermata)
        given = self._metronome | self._for_playback
        counts["usual"] = 0 if given else len(self._usual)
        for onset, speed in (given or self._usual).items():
            self.marks.append(Tempo(max(ZERO, onset), _MINUTE / float(speed)))

    def _is_chorale(self, ends: Iterable[Fraction]) -> bool:
        """Whether fermatas that end there [quarters] are a few bars apart, as in a chorale."""
        bars = sorted({bisect_left(self._begins, end) for end in ends})
        if len(bars) < _MIN_LINES or len(self._begins) - 1 - bars[-1] > _LINE[1]:
            return False
        return _LINE[0] <= bars[-1] / len(bars) <= _LINE[1]

    def _read_direction(self, placed: Placed, end_of_line: Fraction | None) -> None:
        """Read a direction, or a sound outside of any, and the line after its words."""
        element, sounds = placed.element, placed.sounds
        tempos = [sound for sound in sounds if sound.get("tempo") is not None]
        for sound in tempos:
            speed = number(sound.get("tempo"))
            if _is_possible(speed):
                self._for_playback[placed.sounds_at(sound)] = speed
            else:
                self._counts["impossible"] += 1
        for metronome in element.iterfind("direction-type/metronome"):
            mark, place = _Metronome(metronome), placed.sounds_at()
            if (shown := mark.quarters_a_minute) is not None:
                self._metronome[place] = shown
            elif mark.swing is not None:
                self._swing(placed, *mark.swing, mark.before[0])
            elif mark.slower is not None:
                self.marks.append(Modulation(place, mark.slower))
            else:
                self._counts["unclear"] += not tempos
        for sound in sounds:
            for sign in sound.iterfind("swing"):
                unit = NOTE_VALUES.get(sign.findtext("swing-type", "").strip(), _EIGHTH)
                shares = (int(number(sign.findtext(tag))) for tag in ("first", "second"))
                first, second = (min(max(each, 1), _MAX_SWING) for each in shares)
                self._swing(placed, first, second, unit)
        for words in placed.element.iterfind("direction-type/words"):
            text = words.text or ""
            if not tempos and (change := tempo_change(text)):
                self.marks.append(TempoWord(placed.sounds_at(), change, end_of_line))
            if usual := usual_tempo(text):
                self._usual[placed.sounds_at()] = Fraction(usual)
            if (ratio := swing(text)) and placed.element.find("sound/swing") is None:
                self._swing(placed, *ratio, _EIGHTH)

    def _swing(self, placed: Placed, first: int, second: int, unit: Fraction) -> None:
        beat = self._begins[placed.measure + 1]  # that of a pickup would be between beats
        self.swings.append(Swing(placed.quarter, first, second, unit, beat))


def _fermatas(placed: Placed) -> Iterator[Fermata]:
    """Yield the fermatas of a note or rest, or of a barline."""
    element, end = placed.element, placed.quarter + placed.duration
    for sign in (*element.iterfind("fermata"), *element.iterfind("notations/fermata")):
        factor = _FERMATAS.get((sign.text or "").strip(), FERMATA)
        yield Fermata(placed.quarter, end, factor)


def _is_possible(speed: Fraction) -> bool:
    """Whether music may have a tempo, in quarters a minute."""
    return _SLOWEST <= speed <= _FASTEST


class _Metronome:
    """A metronome mark: lengths of notes [quarters], and a number a minute or notes `after`."""

    def __init__(self, mark: Element) -> None:
        self.before: list[Fraction] = []
        self.after: list[Fraction] = []
        self.per_minute = ZERO
        notes, unit, tuplet = self.before, ZERO, Fraction(1)
        for each in mark:
            text = (each.text or "").strip()
            if each.tag == "beat-unit":
                notes, unit = self.after if self.before else self.before, length_of(text, dots=0)
                notes.append(unit)
            elif each.tag == "beat-unit-dot" and notes:
                unit /= 2
                notes[-1] += unit
            elif each.tag == "beat-unit-tied" and notes:
                notes[-1] += _length(each, "beat-unit")
            elif each.tag == "metronome-relation":
                notes = self.after
            elif each.tag == "metronome-note":
                bracket = each.find("metronome-tuplet")
                kind = None if bracket is None else bracket.get("type")
                if bracket is not None and kind == "start":
                    tuplet = _shortened(bracket)
                notes.append(_length(each, "metronome-type") * tuplet)
                if kind == "stop":
                    tuplet = Fraction(1)
            elif each.tag == "per-minute" and (digits := _PER_MINUTE.search(text)):
                self.per_minute = number(digits[0].replace(",", "."))

    @property
    def quarters_a_minute(self) -> Fraction | None:
        """The tempo, if a number gives one that may be."""
        speed = sum(self.before, ZERO) * self.per_minute
        return speed if _is_possible(speed) else None

    @property
    def slower(self) -> Fraction | None:
        """How many times longer notes are now, by what the mark says is equal; None if nothing."""
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


def _length(note: Element, tag: str) -> Fraction:
    """The length of a note in a mark, with its dots [quarters]."""
    dots = sum(each.tag in ("beat-unit-dot", "metronome-dot") for each in note)
    return length_of(note.findtext(tag, ""), dots)


def _shortened(tuplet: Element) -> Fraction:
    """What the lengths of the notes in a tuplet are multiplied by."""
    actual, normal = (
        min(max(number(tuplet.findtext(tag)), Fraction(1)), _MAX_TUPLET)
        for tag in ("actual-notes", "normal-notes")
    )
    return normal / actual
