"""Scores as MusicXML, to be read and played by people."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from itertools import groupby, pairwise
from math import gcd
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from cadenza.files import write_atomically
from cadenza.fingers import LEFT, RIGHT
from cadenza.music.formats.musicxml.marks import FORTE
from cadenza.music.formats.source import printable
from cadenza.music.notation.marks import PedalMark, TempoMark
from cadenza.music.notation.metre import QUARTER
from cadenza.music.notation.note_values import TYPES
from cadenza.music.notation.sheet import Sheet, Symbol, WrittenMeasure, sheet_of
from cadenza.music.notation.spelling import Spelling
from cadenza.music.score import STEPS, Note, Score
from cadenza.music.signs.ornaments import alteration

_HEADER = """<?xml version="1.0" encoding="UTF-8"?>
<!DOCTYPE score-partwise PUBLIC "-//Recordare//DTD MusicXML 4.0 Partwise//EN" \
"http://www.musicxml.org/dtds/partwise.dtd">
"""
_PART = "P1"
_VOICES_OF_STAFF = 4  # numbers of voices that notation programs give to a staff
_CLEF_LINES = {"G": 2, "F": 4}
_ACCIDENTALS = {-2: "flat-flat", -1: "flat", 0: "natural", 1: "sharp", 2: "double-sharp"}
_UNFLAGGED = 3  # the first note values have no flags
_MINUTE = 60  # seconds
_DOTTED = 1.5  # quarters of a dotted one
_LATE = (
    QUARTER // 16
)  # ticks by which a note may lie after the fermata over it, as it was quantised
_HALF = 2  # the lower number of a time signature whose beats are half notes


def write_musicxml(score: Score, path: str | Path) -> tuple[str, ...]:
    """Write a score for piano as MusicXML 4.0, uncompressed.

    Times are quantised: in each beat notes move to the grid of semiquavers, triplets or the like
    that fits best. Tempos are written such that beats keep their times. Bars are those of the
    score; if it has none, they are estimated. The right hand is on the upper staff and the left one
    on the lower, with fingers numbered from 1; notes without a finger are put by the hand that they
    are written for, or by their pitch. Velocities are kept for playback and shown as dynamic marks;
    the pedal is either down or up. Read back, time 0 is the beginning of the bar of the first note.
    Raises CadenzaError if the score has no notes. Returns remarks in plain words on what is not as
    in the score, which the file has, too.
    """
    sheet = sheet_of(score)
    with write_atomically(Path(path)) as file:
        file.write(musicxml_of(sheet).encode())
    return sheet.remarks


def musicxml_of(sheet: Sheet, has_fermatas: bool = False) -> str:
    """The text of a MusicXML file.

    It has fermatas only to be drawn: its tempos last as long as these do, and whoever plays the
    file would wait twice.
    Its notes have ids: `n0` and so on in the order of `Sheet.notes`; what a note `n0` is tied to
    has the ids `n0.1` and so on.
    """
    root = _document(sheet, has_fermatas)
    indent(root, "")
    return _HEADER + tostring(root, "unicode") + "\n"


def _document(sheet: Sheet, has_fermatas: bool) -> Element:
    root = Element("score-partwise", version="4.0")
    if title := printable(sheet.title):
        _text(SubElement(root, "work"), "work-title", title)
    identification = SubElement(root, "identification")
    encoding = SubElement(identification, "encoding")
    _text(encoding, "software", "Cadenza")
    for element in ("accidental", "beam"):
        SubElement(encoding, "supports", element=element, type="yes")
    if sheet.remarks:
        miscellaneous = SubElement(identification, "miscellaneous")
        for remark in sheet.remarks:
            _text(miscellaneous, "miscellaneous-field", remark).set("name", "remark")
    listed = SubElement(SubElement(root, "part-list"), "score-part", id=_PART)
    _text(listed, "part-name", "Piano").set("print-object", "no")  # it is the only one
    part = SubElement(root, "part", id=_PART)
    writer = _Writer(sheet, has_fermatas)
    for i, _ in enumerate(sheet.measures):
        writer.write(part, i)
    return root


class _Writer:
    """The writer of the measures of a sheet, with as few divisions of a quarter as suffice."""

    def __init__(self, sheet: Sheet, has_fermatas: bool) -> None:
        self._sheet, self._has_fermatas = sheet, has_fermatas
        self._unit = gcd(QUARTER, *_ticks(sheet))
        self._number = {id(note): i for i, note in enumerate(sheet.notes)}
        self._continued = Counter[int]()

    def write(self, part: Element, index: int) -> None:
        current = self._sheet.measures[index]
        measure = SubElement(part, "measure", number=str(current.measure.number))
        if current.measure.is_part:
            measure.set("implicit", "yes")
        previous, following = (
            self._sheet.measures[i] if 0 <= i < len(self._sheet.measures) else None
            for i in (index - 1, index + 1)
        )
        self._attributes(measure, current, previous)
        for hand, staff in enumerate(current.staves):
            accidentals = _accidentals(staff.voices, current.key)
            for number, symbols in enumerate(staff.voices, start=1):
                if (hand, number) != (RIGHT, 1):
                    self._duration(SubElement(measure, "backup"), current.measure.length)
                voice = _Voice(number, hand, symbols, accidentals)
                others = [each and each.staves[hand].octave for each in (previous, following)]
                if voice.is_first and staff.octave and others[0] != staff.octave:
                    measure.append(_octave_shift("down" if staff.octave > 0 else "up", hand))
                self._voice(measure, current, voice)
                if voice.is_first and staff.octave and others[1] != staff.octave:
                    measure.append(_octave_shift("stop", hand))
        if index == len(self._sheet.measures) - 1:
            barline = SubElement(measure, "barline", location="right")
            _text(barline, "bar-style", "light-heavy")

    def _attributes(
        self, measure: Element, current: WrittenMeasure, previous: WrittenMeasure | None
    ) -> None:
        attributes = Element("attributes")
        if previous is None:
            _text(attributes, "divisions", QUARTER // self._unit)
        if previous is None or previous.key != current.key:
            _text(SubElement(attributes, "key"), "fifths", current.key)
        if previous is None or previous.measure.written != current.measure.written:
            time = SubElement(attributes, "time")
            _text(time, "beats", current.measure.written[0])
            _text(time, "beat-type", current.measure.written[1])
        if previous is None:
            _text(attributes, "staves", len(current.staves))
        for number, staff in enumerate(current.staves, start=1):
            if previous is None or previous.staves[number - 1].clef != staff.clef:
                clef = SubElement(attributes, "clef", number=str(number))
                _text(clef, "sign", staff.clef)
                _text(clef, "line", _CLEF_LINES[staff.clef])
        if len(attributes):
            measure.append(attributes)

    def _voice(self, measure: Element, here: WrittenMeasure, voice: _Voice) -> None:
        start, end = here.measure.start, here.measure.end
        directions = deque(_directions(here, voice.hand) if voice.is_first else ())
        if not voice.symbols:
            self._put(measure, directions, start, end)
            rest = SubElement(measure, "note")
            SubElement(rest, "rest", measure="yes")
            self._lasting(rest, end - start, voice)
        beams = _beams(voice.symbols, here)
        for i, (symbol, following) in enumerate(pairwise([*voice.symbols, None])):
            assert symbol is not None
            until = end if following is None else following.value.start - 1
            self._put(measure, directions, symbol.value.start, until)
            if symbol.notes or voice.is_first or symbol.value.actual > 1:
                shown = here.fermatas if self._has_fermatas and voice.is_first else ()
                begin, stop = (tick - _LATE for tick in (symbol.value.start, symbol.value.end))
                waits = any(begin <= tick < stop for tick in shown)
                self._symbol(measure, symbol, voice, beams.get(i, ()), waits)
            else:
                forward = SubElement(measure, "forward")
                self._lasting(forward, symbol.value.end - symbol.value.start, voice)

    def _put(
        self, measure: Element, directions: deque[tuple[int, Element]], position: int, until: int
    ) -> None:
        """Write at tick `position` the directions up to `until`, with their offsets."""
        while directions and directions[0][0] <= until:
            tick, direction = directions.popleft()
            if tick != position:
                offset = Element("offset")
                offset.text = str((tick - position) // self._unit)
                if direction.tag == "direction":
                    offset.set("sound", "yes")
                direction.insert(1, offset)  # after the type of the direction
            measure.append(direction)

    def _symbol(
        self, measure: Element, symbol: Symbol, voice: _Voice, beams: Sequence[str], waits: bool
    ) -> None:
        for i, each in enumerate(symbol.notes or (None,)):
            note = SubElement(measure, "note")
            if i:
                SubElement(note, "chord")
            if each is None:
                SubElement(note, "rest")
            else:
                note.set("id", self._id(each[0]))
                note.set("dynamics", f"{100 * each[0].velocity / FORTE:.2f}")
                _pitch(note, each[1])
            self._duration(note, symbol.value.end - symbol.value.start)
            for kind in _ties(symbol):
                SubElement(note, "tie", type=kind)
            _text(note, "voice", voice.name)
            _text(note, "type", symbol.value.name)
            for _ in range(symbol.value.dots):
                SubElement(note, "dot")
            if each is not None and (sign := voice.accidentals.get((id(symbol), i))):
                _text(note, "accidental", sign)
            if symbol.value.actual > 1:
                changed = SubElement(note, "time-modification")
                _text(changed, "actual-notes", symbol.value.actual)
                _text(changed, "normal-notes", symbol.value.normal)
                _text(changed, "normal-type", symbol.value.base)
            _text(note, "staff", voice.staff)
            if not i:
                for number, beam in enumerate(beams, start=1):
                    _text(note, "beam", beam).set("number", str(number))
            notations = _notations(symbol, each[0] if each else None, is_first=not i)
            if not i and waits:
                SubElement(notations, "fermata", type="upright")
            if len(notations):
                note.append(notations)

    def _id(self, note: Note) -> str:
        """An id for the next symbol of a note, see `musicxml_of`."""
        number = self._number[id(note)]
        part = self._continued[number]
        self._continued[number] += 1
        return f"n{number}.{part}" if part else f"n{number}"

    def _lasting(self, element: Element, ticks: int, voice: _Voice) -> None:
        """Say how long a rest lasts, or the motion in place of one, and where."""
        self._duration(element, ticks)
        _text(element, "voice", voice.name)
        _text(element, "staff", voice.staff)

    def _duration(self, element: Element, ticks: int) -> None:
        _text(element, "duration", ticks // self._unit)


def _accidentals(voices: Sequence[Sequence[Symbol]], key: int) -> dict[tuple[int, int], str]:
    """The accidentals of a staff in a measure, by symbol and index of the note."""
    alterations: dict[tuple[str, int], int] = {}
    signs: dict[tuple[int, int], str] = {}
    symbols = sorted((s for voice in voices for s in voice), key=lambda s: s.value.start)
    for symbol in symbols:
        for i, (_, name) in enumerate(symbol.notes):
            place = name.step, name.octave
            if symbol.tied:
                continue
            if alterations.get(place, alteration(STEPS.index(name.step), key)) != name.alter:
                signs[id(symbol), i] = _ACCIDENTALS[name.alter]
            alterations[place] = name.alter
    return signs


class _Voice(NamedTuple):
    """A voice of a hand in a measure, with the accidentals of its staff.

    The first voice has number 1. Accidentals are by symbols and indices of notes.
    """

    number: int
    hand: int
    symbols: tuple[Symbol, ...]
    accidentals: dict[tuple[int, int], str]

    @property
    def is_first(self) -> bool:
        return self.number == 1

    @property
    def name(self) -> str:
        return str(self.hand * _VOICES_OF_STAFF + self.number)

    @property
    def staff(self) -> str:
        return str(self.hand + 1)


def _text(parent: Element, tag: str, text: object) -> Element:
    element = SubElement(parent, tag)
    element.text = str(text)
    return element


def _ticks(sheet: Sheet) -> Iterator[int]:
    for measure in sheet.measures:
        yield measure.measure.end
        yield from (tempo.tick for tempo in measure.tempos)
        yield from (mark.tick for mark in measure.pedal)
        for staff in measure.staves:
            for voice in staff.voices:
                yield from (symbol.value.end for symbol in voice)


def _pitch(note: Element, name: Spelling) -> None:
    pitch = SubElement(note, "pitch")
    _text(pitch, "step", name.step)
    if name.alter:
        _text(pitch, "alter", name.alter)
    _text(pitch, "octave", name.octave)


def _ties(symbol: Symbol) -> list[str]:
    return ["stop"] * symbol.tied + ["start"] * symbol.ties


def _notations(symbol: Symbol, note: Note | None, is_first: bool) -> Element:
    notations = Element("notations")
    for kind in _ties(symbol) if note is not None else ():
        SubElement(notations, "tied", type=kind)
    for kind, is_tied in (("start", symbol.value.opens), ("stop", symbol.value.closes)):
        if is_first and is_tied:
            SubElement(notations, "tuplet", type=kind, number="1")
    if note is not None and note.finger is not None and not symbol.tied:
        placement = "above" if note.finger.hand == RIGHT else "below"
        technical = SubElement(notations, "technical")
        _text(technical, "fingering", note.finger.index + 1).set("placement", placement)
    if note is not None and symbol.roll is not None:
        arpeggio = SubElement(notations, "arpeggiate")
        if symbol.roll.of_both:
            arpeggio.set("number", "1")
        if not symbol.roll.is_up:
            arpeggio.set("direction", "down")
    return notations


def _directions(measure: WrittenMeasure, hand: int) -> Iterator[tuple[int, Element]]:
    """Yield directions by their ticks: dynamics and tempos above, the pedal below."""
    if hand != RIGHT:
        yield from ((mark.tick, _pedal(mark)) for mark in measure.pedal)
        return
    if measure.wedge:
        yield measure.measure.start, _direction("wedge", RIGHT, "below", type=measure.wedge)[0]
    if measure.dynamic:
        direction, sign = _direction("dynamics", RIGHT, "below")
        SubElement(sign, measure.dynamic)
        yield measure.measure.start, direction
    for tempo in measure.tempos:
        yield tempo.tick, _tempo(tempo, measure)
        if tempo.words:
            direction, words = _direction("words", RIGHT, "above")
            words.text = tempo.words
            direction.append(_sound(tempo))  # for readers that would play the words, too
            yield tempo.tick, direction


def _sound(tempo: TempoMark) -> Element:
    return Element("sound", tempo=f"{_MINUTE / tempo.seconds:.4f}")


def _tempo(tempo: TempoMark, here: WrittenMeasure) -> Element:
    if not tempo.shown:
        return _sound(tempo)
    per_minute = _MINUTE / tempo.seconds
    direction, mark = _direction("metronome", RIGHT, "above")
    is_cut = here.measure.written[1] == _HALF
    _text(mark, "beat-unit", "half" if is_cut else "quarter")
    if is_cut:
        per_minute /= 2
    if here.divisions.is_compound:
        SubElement(mark, "beat-unit-dot")
        per_minute /= _DOTTED
    _text(mark, "per-minute", round(per_minute))
    direction.append(_sound(tempo))
    return direction


def _pedal(mark: PedalMark) -> Element:
    kind = "start" if mark.is_down else "stop"
    return _direction("pedal", LEFT, "below", type=kind, line="yes")[0]


def _octave_shift(kind: str, hand: int) -> Element:
    """An 8va, "down" from what sounds to what is written, or 8vb, or where either stops."""
    placement = "above" if hand == RIGHT else "below"
    return _direction("octave-shift", hand, placement, type=kind, size="8")[0]


def _direction(tag: str, hand: int, placement: str, **attributes: str) -> tuple[Element, Element]:
    """A direction for the staff of a hand, and the sign in it."""
    direction = Element("direction", placement=placement)
    sign = SubElement(SubElement(direction, "direction-type"), tag, attributes)
    _text(direction, "staff", hand + 1)
    return direction, sign


def _beams(voice: Sequence[Symbol], here: WrittenMeasure) -> dict[int, list[str]]:
    """The beams of the symbols of a voice, by their indices: one for each flag."""
    flags = [max(0, TYPES.index(s.value.name) - _UNFLAGGED + 1) if s.notes else 0 for s in voice]
    groups = [here.divisions.beam_group(symbol.value.start) for symbol in voice]
    beams: dict[int, list[str]] = {}
    runs = groupby(range(len(voice)), key=lambda i: (groups[i], flags[i] > 0))
    for (_, is_flagged), run in runs:
        indices = list(run)
        if not is_flagged or len(indices) < 2:
            continue
        group_flags = [flags[i] for i in indices]
        for k, i in enumerate(indices):
            beams[i] = [_beam(group_flags, k, level) for level in range(1, group_flags[k] + 1)]
    return beams


def _beam(flags: Sequence[int], k: int, level: int) -> str:
    continues_before = k > 0 and flags[k - 1] >= level
    continues_after = k + 1 < len(flags) and flags[k + 1] >= level
    if continues_before and continues_after:
        return "continue"
    if continues_before or continues_after:
        return "end" if continues_before else "begin"
    return "backward hook" if k else "forward hook"
