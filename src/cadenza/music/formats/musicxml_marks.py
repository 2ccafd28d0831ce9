"""Marks in a part of MusicXML that partitura leaves out: jumps, tempos, ties, bars of notes.

Places are a measure, from 0, and how far into it, in the divisions of a quarter that hold there.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.etree import ElementTree

from cadenza.music.formats.bar_order import Signs
from cadenza.music.score import BEAT_TYPES

Element = ElementTree.Element
Place = tuple[int, int]

_JUMP = re.compile(r"\b(d\. ?[cs]\.|da capo\b|dal segno\b)", re.IGNORECASE)
_PASS = re.compile(r"\d{1,3}")
_MOST_TIMES = 999  # that a section is played, as endings are numbered
_MINUTE = 60  # seconds
FORTE = 90
"""The velocity that MusicXML's `dynamics` attributes are in percent of."""
VELOCITIES = {"ppp": 16, "pp": 33, "p": 49, "mp": 64, "mf": 80, "f": 96, "ff": 112, "fff": 126}
"""The velocities of dynamic markings."""


@dataclass(frozen=True, slots=True)
class NoteMarks:
    """The measure of a note or rest, whether a tie leads to it and on from it, and its velocity.

    The velocity is None where the note has none of its own.
    """

    measure: int
    tied: bool
    ties: bool
    velocity: int | None


@dataclass(slots=True)
class Marks:
    """The marks of one part.

    `notes` are notes and rests in the order of the document. `numbers` are those of measures, as
    printed if that is a number. `beat_types` say for measures which part of a whole note a beat
    is. `staves` is the number of staves. `bars` are measures, or their parts between repeat
    signs: the place of the beginning, and the signs. `tempos` are places and lengths of a
    quarter [s]. `in_words` counts jumps that are words without a sign for playback.
    """

    notes: list[NoteMarks] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    beat_types: list[int] = field(default_factory=list)
    staves: int = 1
    bars: list[tuple[Place, Signs]] = field(default_factory=list)
    tempos: list[tuple[Place, float]] = field(default_factory=list)
    in_words: int = 0


def marks_of(part: Element) -> Marks:
    """The marks in a `<part>`, whose numbers have been mended."""
    marks = Marks()
    bracket: frozenset[int] = frozenset()  # of the ending that goes on
    following = Signs()
    beat_type = 4
    for number, measure in enumerate(part.iterfind("measure")):
        signs, following = following, Signs()
        signs.ending = bracket
        marks.bars.append(((number, 0), signs))
        printed = measure.get("number", "")
        marks.numbers.append(int(printed) if printed.isdecimal() else number + 1)
        said = _whole(measure.findtext("attributes/time/beat-type"))
        beat_type = said if said in BEAT_TYPES else beat_type
        marks.beat_types.append(beat_type)
        marks.staves = max(marks.staves, _whole(measure.findtext("attributes/staves")))
        elements = list(placed(measure))
        end = max(at for at, _ in elements)
        for at, element in elements:
            if element.tag == "note":
                marks.notes.append(NoteMarks(number, *_ties(element), _velocity(element)))
            elif element.tag == "barline":
                bracket = _read_barline(element, (number, at), marks.bars, following, bracket)
            elif element.tag in ("direction", "sound"):
                here = marks.bars[-1][1]
                for sound in element.iter("sound"):
                    _read_jumps(sound, here)
                    _read_goals(sound, following if at >= end > 0 else here)
                    if tempo := sound.get("tempo"):
                        place = number, at + _offset(element, sound)
                        marks.tempos.append((place, _MINUTE / float(tempo)))
        marks.in_words += _jumps_in_words(measure, marks.bars[-1][1])
    return marks


def placed(measure: Element) -> Iterator[tuple[int, Element]]:
    """Yields places in a measure and its elements; last its end, with the measure itself."""
    now = begun = 0
    for element in measure:
        if element.tag == "note":
            begun = begun if element.find("chord") is not None else now
            yield begun, element
            now = begun + _whole(element.findtext("duration"))
            continue
        yield now, element
        if element.tag == "forward":
            now += _whole(element.findtext("duration"))
        elif element.tag == "backup":
            now = max(0, now - _whole(element.findtext("duration")))
    yield now, measure


def _whole(text: str | None) -> int:
    """The whole number, 0 for other text, as partitura reads it."""
    try:
        return int(text or "")
    except ValueError:
        return 0


def _ties(note: Element) -> tuple[bool, bool]:
    """Whether a tie leads to the note, and one on from it."""
    kinds = {tie.get("type") for tie in (*note.iterfind("tie"), *note.iterfind("notations/tied"))}
    return "stop" in kinds or "continue" in kinds, "start" in kinds or "continue" in kinds


def _velocity(note: Element) -> int | None:
    """The velocity of a note for playback, as MusicXML has it: in percent of that of a forte."""
    try:
        velocity = round(float(note.get("dynamics", "")) * FORTE / 100)
    except (ValueError, OverflowError):
        return None
    return min(max(velocity, 1), 127)


def _offset(element: Element, sound: Element) -> int:
    """The offset of a sound from the place of its element."""
    shown = element.find("offset")
    if shown is not None and element is not sound and shown.get("sound") != "yes":
        shown = None  # only on paper
    return _whole(shown.text if shown is not None else sound.findtext("offset"))


def _read_barline(
    barline: Element,
    place: Place,
    bars: list[tuple[Place, Signs]],
    following: Signs,
    bracket: frozenset[int],
) -> frozenset[int]:
    """Adds the signs of a barline, and a new bar at a repeat sign within a measure.

    Returns:
        The bracket of the ending that goes on behind it.
    """
    location = barline.get("location", "right")
    signs = bars[-1][1]
    repeat, ending = barline.find("repeat"), barline.find("ending")
    if ending is not None and (ending.get("type") == "start" or not bracket):
        passes = _PASS.findall(ending.get("number", "")) or _PASS.findall(ending.text or "")
        signs.ending = bracket = frozenset(map(int, passes))
    if ending is not None and ending.get("type") != "start":
        bracket = frozenset()
    direction = repeat.get("direction") if repeat is not None else None
    if repeat is not None and direction == "backward":
        repeated = bars[-2][1] if location == "left" and len(bars) > 1 else signs
        repeated.times = min(max(2, _whole(repeat.get("times"))), _MOST_TIMES)
    if direction and location == "middle" and place > bars[-1][0]:
        signs = Signs(ending=bracket)
        bars.append((place, signs))
    if direction == "forward":
        begun = following if location == "right" else signs
        begun.begins_repeat = True
        if ending is None:
            begun.ending = bracket = frozenset()
    return bracket


def _read_jumps(sound: Element, signs: Signs) -> None:
    signs.da_capo |= sound.get("dacapo", "no") != "no"
    signs.fine |= sound.get("fine", "no") != "no"
    signs.dal_segno = sound.get("dalsegno", signs.dal_segno)
    signs.to_coda = sound.get("tocoda", signs.to_coda)


def _read_goals(sound: Element, signs: Signs) -> None:
    signs.segno = sound.get("segno", signs.segno)
    signs.coda = sound.get("coda", signs.coda)


def _jumps_in_words(measure: Element, signs: Signs) -> int:
    if signs.da_capo or signs.dal_segno is not None:
        return 0
    words = measure.iterfind("direction/direction-type/words")
    return sum(bool(_JUMP.search(each.text or "")) for each in words)
