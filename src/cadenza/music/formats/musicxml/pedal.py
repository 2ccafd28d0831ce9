"""The pedals, by their signs and by what is said for playback."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple
from xml.etree.ElementTree import Element

from cadenza.music.formats.musicxml.timeline import Placed, number

PEDALS = _SUSTAIN, _SOSTENUTO = "damper-pedal", "sostenuto-pedal"
"""The pedals that are played, as sounds for playback call them."""
_SOFT = "soft-pedal"
_SOFT_IN_WORDS = re.compile(r"\b(una corda|u\. ?c\.|due corde)", re.IGNORECASE)
_SOSTENUTO_IN_WORDS = re.compile(r"\bsost(enuto|\.)? ?ped", re.IGNORECASE)
_DOWN, _UP = 127, 0
_SIGNS = {
    **dict.fromkeys(("start", "sostenuto", "resume"), (_DOWN,)),
    **dict.fromkeys(("stop", "discontinue"), (_UP,)),
    "change": (_UP, _DOWN),
}


class Move(NamedTuple):
    """The pedal moves to a value, in a measure, at a quarter of the sheet."""

    measure: int
    quarter: Fraction
    value: int


def pedal_moves(part: Iterable[Placed], begins: Sequence[Fraction], pedal: str) -> list[Move]:
    """The motions of a pedal of a part, in the order of their times.

    A sign moves by its offset for playback, as far as its measure reaches. A pedal that is pressed
    again without having been lifted is lifted before. A sign that lifts a pedal is for the one that
    went down last.

    Args:
        part: the elements of the part.
        begins: the quarters at which measures begin, and the end of the last.
        pedal: which of `PEDALS`.
    """
    moves: list[Move] = []
    down = defaultdict[str, list[str]](list)  # pedals, by the numbers of their signs
    for placed in part:
        if placed.element.tag in ("direction", "sound"):
            begin, end = begins[placed.measure : placed.measure + 2]
            for quarter, value in _values(placed, pedal, down):
                moves.append(Move(placed.measure, min(max(quarter, begin), end), value))
    moves.sort(key=lambda move: move[:2])
    again = [
        after._replace(value=_UP)
        for before, after in pairwise(moves)
        if before.value == after.value == _DOWN and before.quarter < after.quarter
    ]
    return sorted([*again, *moves], key=lambda move: move[:2])


def has_soft_pedal(root: Element) -> bool:
    """Whether a soft pedal goes down, in words or for playback."""
    words = (_SOFT_IN_WORDS.search(each.text or "") for each in root.iter("words"))
    return any(words) or any(_value(sound.get(_SOFT)) for sound in root.iter("sound"))


def sostenuto_words(root: Element) -> int:
    """The number of words for the sostenuto pedal, which do not say how long; 0 beside signs."""
    signs = (sign.get("type") == "sostenuto" for sign in root.iter("pedal"))
    if any(signs) or any(sound.get(_SOSTENUTO) for sound in root.iter("sound")):
        return 0
    words = (_SOSTENUTO_IN_WORDS.search(each.text or "") for each in root.iter("words"))
    return sum(each is not None for each in words)


def _values(
    placed: Placed, pedal: str, down: Mapping[str, list[str]]
) -> list[tuple[Fraction, int]]:
    """The quarters at which an element moves a pedal, and to which values."""
    signs: list[tuple[Fraction, int]] = []
    for sign in placed.element.iterfind("direction-type/pedal"):
        kind, others = sign.get("type", ""), down[sign.get("number", "1")]
        if kind in ("start", "sostenuto"):
            others.append(_SUSTAIN if kind == "start" else _SOSTENUTO)
        if pedal == (others[-1] if others else _SUSTAIN):
            signs += ((placed.sounds_at(), value) for value in _SIGNS.get(kind, ()))
        if kind == "stop" and others:
            others.pop()
    given = [
        (placed.sounds_at(sound), value)
        for sound in placed.sounds
        if (value := _value(sound.get(pedal))) is not None
    ]
    return [*signs[:-1], *given] if given else signs


def _value(given: str | None) -> int | None:
    """The value of a pedal for playback: yes, no, or in percent."""
    if given is None:
        return None
    percent = {"yes": 100, "no": 0}.get(given) if given in ("yes", "no") else number(given)
    return round(_DOWN * min(max(percent or 0, 0), 100) / 100)
