"""When the elements of measures begin, in quarters of the sheet."""

import re
from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import accumulate
from operator import itemgetter
from typing import NamedTuple, TypeVar
from xml.etree.ElementTree import Element

ZERO = Fraction(0)
_FIRST_VOICE = "1"
MAX_STAVES = 16  # staves of a part that are told apart; beyond, all are one
_FINEST = 10**6  # parts of a quarter that are told apart; more would make sums slow
_UNIT = 10_000  # parts of a whole number that are told apart, so that 1.3333333 is 4/3
_T = TypeVar("_T")
_REMEMBERED = 4096  # numbers, as a file has few different ones
_NUMBER = re.compile(r"[+-]?([0-9]{1,12}(\.[0-9]{0,12})?|\.[0-9]{1,12})")
_TYPES = "maxima long breve whole half quarter eighth 16th 32nd 64th 128th 256th 512th 1024th"
NOTE_VALUES = {name: Fraction(32, 2**i) for i, name in enumerate(_TYPES.split())}
"""The lengths of note values [quarters]."""
_WHOLE = NOTE_VALUES["whole"]
_LINES = ("dashes", "bracket")  # after words, as far as these hold
_MAX_DOTS = 4


class Placed(NamedTuple):
    """An element of a measure, counted from 0, and the quarter of the sheet where it begins.

    `divisions` make a quarter there. Notes have a voice, others that of the note before. The first
    element of each measure is itself.
    """

    measure: int
    quarter: Fraction
    element: Element
    divisions: Fraction
    voice: str

    @property
    def duration(self) -> Fraction:
        """The length that the element gives [quarters]; 0 without one, as of grace notes."""
        return max(ZERO, exact(number(self.element.findtext("duration")) / self.divisions))

    @property
    def staff(self) -> int | None:
        """The staff that the element names, if any."""
        return _staff(self.element.findtext("staff")) or None

    @property
    def all_sounds(self) -> list[Element]:
        """What a direction says for playback, or an element outside of any."""
        if self.element.tag == "direction":
            return self.element.findall("sound")
        return [self.element] if self.element.tag == "sound" else []

    @property
    def sounds(self) -> list[Element]:
        """What is said for playback on all passes."""
        return [sound for sound in self.all_sounds if not passes_of(sound)]

    def sounds_at(self, sound: Element | None = None) -> Fraction:
        """The quarter of the sheet at which the element, or a `sound` in it, takes effect."""
        offset = self.element.find("offset")
        if self.element.tag == "direction" and offset is not None and offset.get("sound") != "yes":
            offset = None  # only on paper
        if offset is None and sound is not None:
            offset = sound.find("offset")
        if offset is None:
            return self.quarter
        return exact(self.quarter + number(offset.text) / self.divisions)


def passes_of(element: Element) -> frozenset[int]:
    """The passes through its section on which a note or sound is played; empty for all."""
    return numbers_in(element.get("time-only", ""))


def numbers_in(text: str) -> frozenset[int]:
    """The whole numbers in a text, such as those of passes."""
    return frozenset(map(int, re.findall("[0-9]{1,3}", text)))


def length_of(name: str, dots: int) -> Fraction:
    """The length of a note value with dots [quarters]; 0 for an unknown one."""
    return NOTE_VALUES.get(name.strip(), ZERO) * (2 - Fraction(1, 2 ** min(dots, _MAX_DOTS)))


def timeline(parts: Sequence[Element]) -> tuple[list[list[Placed]], list[Fraction]]:
    """The elements of each part, and the quarters at which measures begin; last, their end.

    Measures begin together in all parts: where one is not as long in all of them, the next begins
    when it has ended in all.
    """
    lengths: list[tuple[int, Fraction]] = []
    placed: list[list[Placed]] = []
    for part in parts:
        elements, part_lengths = _placed(part)
        placed.append(elements)
        for measure, length in enumerate(part_lengths[: len(lengths)]):
            lengths[measure] = max(lengths[measure], length)
        lengths += part_lengths[len(lengths) :]
    measures = (each for _, each in lengths)
    begins = [*accumulate(measures, lambda end, each: exact(end + each), initial=ZERO)]
    moved = [
        [each._replace(quarter=begins[each.measure] + each.quarter) for each in elements]
        for elements in placed
    ]
    return moved, begins


def _placed(part: Element) -> tuple[list[Placed], list[tuple[int, Fraction]]]:
    """The elements of a part, by times in their measures, and the measures' weights and lengths.

    If parts have measures of different lengths, the greatest weight counts: 2 for notes that fill
    the metre, 1 for other notes and for rests in a complete measure, 0 for rests in a measure that
    is marked as incomplete, and for an empty measure, which has the length of its metre. Rests do
    not make a measure longer than its metre.
    """
    placed: list[Placed] = []
    lengths: list[tuple[int, Fraction]] = []
    divisions, metre, is_measured = Fraction(1), _WHOLE, False
    for measure, elements in enumerate(part.iterfind("measure")):
        position = chord_onset = length = end_of_notes = ZERO
        is_empty = True
        voice = _FIRST_VOICE
        placed.append(Placed(measure, ZERO, elements, divisions, voice))
        for element in elements:
            if element.tag == "attributes":
                divisions = number(element.findtext("divisions")) or divisions
                if (time := element.find("time")) is not None:
                    metre, is_measured = _metre(time) or metre, time.find("beats") is not None
            is_chord = element.tag == "note" and element.find("chord") is not None
            if element.tag == "note":
                voice = element.findtext("voice", voice if is_chord else _FIRST_VOICE)
            item = Placed(measure, chord_onset if is_chord else position, element, divisions, voice)
            if element.tag in ("note", "forward") and not is_chord:
                chord_onset, position, is_empty = position, exact(position + item.duration), False
                if element.tag == "note" and element.find("rest") is None:
                    end_of_notes = max(end_of_notes, position)
            elif element.tag == "backup":
                position = max(ZERO, exact(position - item.duration))
            length = max(length, position)
            placed.append(item)
        if is_measured and end_of_notes <= metre:
            length = min(length, metre)
        counts = end_of_notes > 0 or elements.get("implicit") != "yes"
        fills = end_of_notes > 0 and length == metre
        lengths.append((0, metre) if is_empty else (counts + fills, length))
    return placed, lengths


def attribute(
    part: Iterable[Placed], tag: str, value: Callable[[Element], _T], before: _T
) -> Callable[[Placed], _T]:
    """A function from an element of a part to the value of an attribute there, such as the key.

    Args:
        part: the elements of the part.
        tag: the name of the attribute, which may be for a staff by its number.
        value: what it says.
        before: what holds before the first.
    """
    marks: defaultdict[int, list[tuple[Fraction, _T]]] = defaultdict(list)
    for placed in part:
        if placed.element.tag == "attributes":
            for each in placed.element.iterfind(tag):
                marks[_staff(each.get("number"))].append((placed.quarter, value(each)))
    marks_of_staves = {
        staff: sorted(marks[staff] + marks[0], key=itemgetter(0)) for staff in [0, *marks]
    }

    def at(placed: Placed) -> _T:
        staff_marks = marks_of_staves.get(placed.staff or 1, marks_of_staves[0])
        count = bisect_right(staff_marks, placed.quarter, key=itemgetter(0))
        return staff_marks[count - 1][1] if count else before

    return at


def ends_of_lines(part: Iterable[Placed]) -> Callable[[Placed], Fraction | None]:
    """A function from a direction with words to where the line after them ends, such as dashes.

    The line begins in the direction itself or in another one at its place; None without one.
    """
    line_at: dict[tuple[Fraction, int | None], tuple[str, str]] = {}  # tags and numbers of lines
    ends: defaultdict[tuple[str, str], list[Fraction]] = defaultdict(list)
    for placed in part:
        for line in _lines(placed):
            name = line.tag, line.get("number", "1")
            if line.get("type") == "start":
                line_at[placed.quarter, placed.staff] = name
            elif line.get("type") == "stop":
                ends[name].append(placed.sounds_at())
    for places in ends.values():
        places.sort()

    def end(placed: Placed) -> Fraction | None:
        starts = (line for line in _lines(placed) if line.get("type") == "start")
        name = next(((line.tag, line.get("number", "1")) for line in starts), None)
        name = name or line_at.get((placed.quarter, placed.staff))
        places = ends.get(name, []) if name else []
        index = bisect_right(places, placed.sounds_at())
        return places[index] if index < len(places) else None

    return end


def _lines(placed: Placed) -> list[Element]:
    if placed.element.tag != "direction":
        return []
    return [each for each in placed.element.iterfind("direction-type/*") if each.tag in _LINES]


def _staff(text: str | None) -> int:
    """The number of a staff; 0 for none."""
    return min(int(number(text)), MAX_STAVES)


def _metre(time: Element) -> Fraction:
    """The length of a bar as a time signature says [quarters]; 0 if it says none."""
    beats = [re.findall("[0-9]{1,3}", each.text or "") for each in time.iterfind("beats")]
    types = [number(each.text) for each in time.iterfind("beat-type")]
    return sum(
        (
            _WHOLE * sum(map(int, counts)) / kind
            for counts, kind in zip(beats, types, strict=False)
            if kind > 0
        ),
        ZERO,
    )


def number(text: str | None, otherwise: Fraction = ZERO) -> Fraction:
    """The number in a text, or what it is `otherwise`."""
    value = number_or_none(text)
    return otherwise if value is None else value


@lru_cache(_REMEMBERED)
def number_or_none(text: str | None) -> Fraction | None:
    """The number in a text of few digits, since others could have billions; None for other text.

    All numbers of a document are read here, and groups of up to three digits by `numbers_in`.
    """
    text = (text or "").strip()
    if not _NUMBER.fullmatch(text):
        return None
    value = Fraction(text)
    return value.limit_denominator(_UNIT) if value.denominator > 1 else value


def exact(quarters: Fraction) -> Fraction:
    """The time itself, unless it is finer than any music."""
    return quarters if quarters.denominator <= _FINEST else quarters.limit_denominator(_FINEST)
