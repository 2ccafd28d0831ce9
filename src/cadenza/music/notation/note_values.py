"""Note values: how a stretch of a measure is written as notes, dots, ties and tuplets."""

from collections.abc import Iterator
from typing import NamedTuple

from cadenza.music.notation.metre import QUARTER, WHOLE, Measure

TYPES = ("whole", "half", "quarter", "eighth", "16th", "32nd", "64th")
"""Names of note values, each half of the one before."""
_PLAIN = {WHOLE >> k: name for k, name in enumerate(TYPES)}
_DOTTED = {3 * (WHOLE >> k) // 2: name for k, name in enumerate(TYPES[:-1])}
_BAR, _GROUP, _HALF, _BEAT = 10, 6, 3, 2  # how strong positions in a measure are
_COMPOUND = 3  # beats of a group in 6/8, 9/8, 12/8


class Value(NamedTuple):
    """A note value from tick `start` to `end`; in a tuplet, `actual` are in the time of `normal`.

    `base` is the unit of the tuplet. `opens` and `closes` say whether the tuplet does here.
    """

    start: int
    end: int
    name: str
    dots: int = 0
    actual: int = 1
    normal: int = 1
    base: str = ""
    opens: bool = False
    closes: bool = False


class Divisions:
    """The hierarchy of positions in a measure, from strong to weak."""

    def __init__(self, measure: Measure) -> None:
        """Find the levels of a measure's time signature."""
        beats, beat_type = measure.written
        beat = WHOLE // beat_type
        self.is_compound = beat_type >= 8 and beats % _COMPOUND == 0 and beats > _COMPOUND
        self.origin = measure.origin
        self._levels = [(_BAR, beats * beat)]
        if self.is_compound:
            self._levels.append((_GROUP, _COMPOUND * beat))
        elif beats == 4:
            self._levels.append((_HALF, 2 * beat))
        strength = _BEAT
        while beat >= WHOLE >> (len(TYPES) - 1):
            self._levels.append((strength, beat))
            strength, beat = strength - 1, beat // 2
        self._beam = _beam(measure, self.is_compound)
        self._last_group = beats * (WHOLE // beat_type) // self._beam - 1

    def strength(self, tick: int) -> int:
        """How strong a position is."""
        at = tick - self.origin
        return next((level for level, spacing in self._levels if at % spacing == 0), -_BAR)

    def strongest_within(self, start: int, end: int) -> tuple[int, int, int] | None:
        """The strongest position strictly between two: its strength, itself, and how many."""
        start, end = start - self.origin, end - self.origin
        for level, spacing in self._levels:
            first, last = start // spacing + 1, (end - 1) // spacing
            if first <= last:
                return level, self.origin + first * spacing, last - first + 1
        return None

    def beam_group(self, tick: int) -> int:
        """The number of the group whose notes share a beam."""
        return min((tick - self.origin) // self._beam, self._last_group)


def _beam(measure: Measure, is_compound: bool) -> int:
    """The ticks that notes under one beam fill: a beat, or three, or a measure such as 3/8.

    Of short beats it is two, and three at the end of an odd number of them: 7/8 is 2 + 2 + 3.
    """
    beats, beat_type = measure.written
    beat = WHOLE // beat_type
    if is_compound or (beat < QUARTER and beats <= _COMPOUND):
        return beat * min(beats, _COMPOUND)
    return 2 * beat if beat < QUARTER else beat


def values(start: int, end: int, divisions: Divisions, is_rest: bool) -> Iterator[Value]:
    """Yield the note values of a stretch without tuplets, which show the beats.

    A single value is not to hide a position that is stronger than both its ends; but a plain note
    may be syncopated about a position one level stronger. A rest begins at a position that is
    stronger than all within.
    """
    name, dots = _PLAIN.get(end - start), 0
    if name is None and (not is_rest or divisions.is_compound):
        name, dots = _DOTTED.get(end - start), 1
    inner = divisions.strongest_within(start, end)
    if name and (inner is None or _is_clear(inner, start, end, divisions, is_rest, dots)):
        yield Value(start, end, name, dots)
    elif inner is None:
        yield from _greedy(start, end)
    else:
        yield from values(start, inner[1], divisions, is_rest)
        yield from values(inner[1], end, divisions, is_rest)


def _is_clear(
    inner: tuple[int, int, int],
    start: int,
    end: int,
    divisions: Divisions,
    is_rest: bool,
    dots: int,
) -> bool:
    strength, _, count = inner
    if is_rest:
        return strength < divisions.strength(start)
    ends = max(divisions.strength(start), divisions.strength(end))
    return strength <= ends or (not dots and strength == ends + 1 and count == 1)


def _greedy(start: int, end: int) -> Iterator[Value]:
    """Yield the longest values first, of what lies between the finest positions."""
    while start < end:
        fitting = [length for length in _PLAIN if length <= end - start]
        length = max(fitting, default=end - start)
        yield Value(start, start + length, _PLAIN.get(length, TYPES[-1]))
        start += length


def tuplet_values(start: int, end: int, first: int, last: int, parts: int) -> Iterator[Value]:
    """Yield the note values of a stretch of the cell from `first` to `last` in `parts`."""
    cell = last - first
    normal = 1 << (parts.bit_length() - 1)
    unit = cell // parts
    base = _PLAIN[cell // normal]
    while start < end:
        units = max(1, round((end - start) / unit))
        count = 1 << (units.bit_length() - 1)
        dots = int(count > 1 and count + count // 2 <= units)
        length = (count + dots * count // 2) * unit
        name = _PLAIN[count * cell // normal]
        opens, closes = start == first, start + length == last
        yield Value(start, start + length, name, dots, parts, normal, base, opens, closes)
        start += length
