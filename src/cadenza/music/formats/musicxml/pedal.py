"""The sustain pedal, by its signs and by what is said for playback."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple, TypeVar
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import Placed, number

_T = TypeVar("_T")
_DOWN, _UP = 127, 0
_SIGNS = {
    **dict.fromkeys(("start", "resume"), (_DOWN,)),
    **dict.fromkeys(("stop", "discontinue"), (_UP,)),
    "change": (_UP, _DOWN),
}


class Move(NamedTuple):
    """The pedal moves to a value, in a measure, at a quarter of the sheet."""

    measure: int
    quarter: Fraction
    value: int


def pedal_moves(part: Iterable[Placed], begins: Sequence[Fraction]) -> list[Move]:
    """The motions of the pedal of a part, in the order of their times.

    A sign moves by its offset for playback, as far as its measure reaches. A pedal that is pressed
    again without having been lifted is lifted before.

    Args:
        part: the elements of the part.
        begins: the quarters at which measures begin, and the end of the last.
    """
    moves: list[Move] = []
    for placed in part:
        if placed.element.tag in ("direction", "sound"):
            begin, end = begins[placed.measure : placed.measure + 2]
            quarter = min(max(placed.sounds_at(), begin), end)
            moves += (Move(placed.measure, quarter, value) for value in _values(placed))
    moves.sort(key=lambda move: move[:2])
    again = [
        after._replace(value=_UP)
        for before, after in pairwise(moves)
        if before.value == after.value == _DOWN and before.quarter < after.quarter
    ]
    return sorted([*again, *moves], key=lambda move: move[:2])


def _values(placed: Placed) -> list[int]:
    """The values that an element moves the pedal to, one after the other."""
    signs = [
        value
        for sign in placed.element.iterfind("direction-type/pedal")
        for value in _SIGNS.get(sign.get("type", ""), ())
    ]
    said = [value for sound in placed.sounds if (value := _damper(sound)) is not None]
    return [*signs[:-1], *said] if said else signs


def _damper(sound: Element) -> int | None:
    """The value of the sustain pedal for playback: yes, no, or in percent."""
    said = sound.get("damper-pedal")
    if said is None:
        return None
    percent = {"yes": 100, "no": 0}.get(said) if said in ("yes", "no") else number(said)
    return round(_DOWN * min(max(percent or 0, 0), 100) / 100)


def together(pedals: Iterable[list[tuple[_T, int]]]) -> list[tuple[_T, int]]:
    """One pedal of several, of places and values in their order: as far down as any of them."""
    used = [pedal for pedal in pedals if pedal]
    if len(used) == 1:
        return used[0]
    values = [0] * len(used)
    moved: list[tuple[_T, int]] = []
    # Lifted before others are pressed, so that all may change at once.
    for place, value, i in sorted((*move, i) for i, pedal in enumerate(used) for move in pedal):
        values[i] = value
        if max(values) != (moved[-1][1] if moved else 0):
            moved.append((place, max(values)))
    return moved
