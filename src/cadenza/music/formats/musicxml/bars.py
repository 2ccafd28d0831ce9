"""The bars of a sheet: where they begin, their beats, and the signs of repeats at their lines."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.bar_order import Signs
from cadenza.music.formats.musicxml.timeline import Placed, number, numbers_in
from cadenza.music.score import BEAT_TYPES

_MAX_TIMES = 999  # that a section is played, as endings are numbered
_MAX_BEATS = 64  # of a bar; a longer one has no metre


@dataclass(slots=True)
class WrittenBar:
    """A measure, or the part of one up to or from a repeat sign within it, in quarters.

    A beat is `1 / beat_type` of a whole note. At a fine within the bar, the music ends at `cut`.
    """

    measure: int
    begin: Fraction
    end: Fraction
    number: int
    beat_type: int
    signs: Signs = field(default_factory=Signs)
    cut: Fraction | None = None

    @property
    def beats(self) -> list[Fraction]:
        """The times at which beats begin; the first is `begin`, and there are none of very many."""
        count = max(1, round((self.end - self.begin) * self.beat_type / 4))
        if count > _MAX_BEATS:
            return []
        return [self.begin + Fraction(4 * beat, self.beat_type) for beat in range(count)]


def bars_of(part: Sequence[Placed], begins: Sequence[Fraction]) -> list[WrittenBar]:
    """The bars of a part, with its repeats and endings.

    Args:
        part: its elements.
        begins: the quarters at which measures begin, and the end of the last.
    """
    reader = _BarReader(begins)
    for placed in part:
        reader.read(placed)
    for bar in reader.bars:
        bar.beat_type = _filling(bar.end - bar.begin, bar.beat_type)
    return reader.bars


def bar_at(bars: Sequence[WrittenBar], measure: int, quarter: Fraction) -> int:
    """The index of the bar that is the measure, or the part of it, at a time."""
    at = bisect_right(bars, (measure, quarter), key=lambda bar: (bar.measure, bar.begin))
    return max(at - 1, 0)


class _BarReader:
    """Reads the elements of a part in their order."""

    def __init__(self, begins: Sequence[Fraction]) -> None:
        self.bars: list[WrittenBar] = []
        self._begins = begins
        self._bracket: frozenset[int] = frozenset()  # of the ending that goes on
        self._is_repeat_next = False
        self._beat_type = 4

    def read(self, placed: Placed) -> None:
        measure, element = placed.measure, placed.element
        if element.tag == "measure":
            self._begin(measure, self._begins[measure], element.get("number", ""))
            self.bars[-1].signs.begins_repeat = self._is_repeat_next
            self._is_repeat_next = False
        elif element.tag == "attributes":
            said = int(number(element.findtext("time/beat-type")))
            self._beat_type = said if said in BEAT_TYPES else self._beat_type
            self.bars[-1].beat_type = self._beat_type
        elif element.tag == "barline":
            self._read_barline(element, placed.quarter)

    def _begin(self, measure: int, quarter: Fraction, printed: str) -> None:
        counted = int(number(printed, Fraction(measure + 1)))
        end, signs = self._begins[measure + 1], Signs(ending=self._bracket)
        self.bars.append(WrittenBar(measure, quarter, end, counted, self._beat_type, signs))

    def _read_barline(self, barline: Element, quarter: Fraction) -> None:
        """Reads a repeat and an ending; within a measure, a repeat begins a new bar."""
        bar = self.bars[-1]
        location = barline.get("location", "right")
        repeat, ending = barline.find("repeat"), barline.find("ending")
        if ending is not None and (ending.get("type") == "start" or not self._bracket):
            passes = numbers_in(ending.get("number", "")) or numbers_in(ending.text or "")
            if ending.get("type") != "start" and repeat is not None:
                passes |= {1}  # of a bracket without a beginning, whatever its number
            bar.signs.ending = self._bracket = passes
        if ending is not None and ending.get("type") != "start":
            self._bracket = frozenset()
        if repeat is None:
            return
        direction = repeat.get("direction")
        if direction == "backward":
            repeated = self.bars[-2 if location == "left" and len(self.bars) > 1 else -1].signs
            repeated.times = min(max(2, int(number(repeat.get("times")))), _MAX_TIMES)
            repeated.after_jump = repeat.get("after-jump") == "yes"
        if direction and location == "middle" and quarter > bar.begin:
            self._begin(bar.measure, quarter, str(bar.number))
            bar.end = quarter
        if direction == "forward":
            self._is_repeat_next = location == "right"
            self.bars[-1].signs.begins_repeat |= location != "right"
            if ending is None:
                self.bars[-1].signs.ending = self._bracket = frozenset()


def _filling(quarters: Fraction, beat_type: int) -> int:
    """The type of beat of a bar: `beat_type`, or a finer one where that does not fill it."""
    finer = (each for each in sorted(BEAT_TYPES) if each >= beat_type)
    return next((each for each in finer if (quarters * each / 4).denominator == 1), beat_type)
