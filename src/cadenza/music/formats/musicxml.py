"""MusicXML, plain or compressed, as notation programs export it."""

from __future__ import annotations

import io
import math
import warnings
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import accumulate, islice, zip_longest
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.formats.bar_order import played_order, without_goal
from cadenza.music.formats.musicxml_marks import VELOCITIES, Marks, marks_of
from cadenza.music.formats.musicxml_mending import mend
from cadenza.music.formats.musicxml_tree import tree_of
from cadenza.music.formats.partitura_modules import partitura_module
from cadenza.music.formats.titles import printable, title_of
from cadenza.music.repair import RawNote, counted_remarks, repaired_notes
from cadenza.music.score import (
    BEAT_TYPES,
    HIGHEST_PITCH,
    LOWEST_PITCH,
    Bar,
    PedalEvent,
    Score,
    Track,
    check_chosen,
)

_MAX_PLAYED = 100_000  # notes or bars, with repeats
_SECONDS_PER_QUARTER = 0.5  # until the file says otherwise, as in MIDI
_GRACE = 0.1  # [s] that a grace note lasts, before the beat
_UNMARKED = 80  # velocity
_PEDAL_DOWN, _PEDAL_UP = 127, 0
_SIGNS = range(1, 6)  # of fingers
_HANDS = {1, 2}  # staves of a part whose staves say which hand plays
_MOST_BEATS = 64  # of a bar; a longer one has no metre
_ROUNDING = 1e-6  # [quarters]


def read_musicxml(path: str | Path, tracks: Collection[int] = ()) -> Score:
    """The piano score in a MusicXML file (.musicxml, .xml or, compressed, .mxl).

    Parts with pitched notes are tracks, see `Score.tracks`; all are played together, or only
    `tracks`. Tied notes are one. Repeats, endings, da capo and dal segno are followed as the
    part with most measures has them, the first of those. Times follow the tempos given for playback
    (`<sound tempo>`, or metronome marks), velocities the `dynamics` of notes or else the dynamic
    markings. Grace notes last 0.1 s before the beat; signs of other ornaments are not played. Of a
    part on two staves hands and fingering are taken over: the upper staff is the right hand's. What
    cannot be played on one piano is repaired as by `read_midi`.

    Raises:
        CadenzaError: no such file, not MusicXML, damaged, too large, without notes, or
            without one of `tracks`.
    """
    path = Path(path)
    sheet = _sheet(tree_of(path), path)
    parts = dict(enumerate((part for part in sheet.parts if part.notes), start=1))
    listed = tuple(_track(number, part) for number, part in parts.items())
    check_chosen(tracks, listed, path)
    if tracks:
        parts = {number: parts[number] for number in sorted(set(tracks))}

    counts = Counter[str]()
    found, pedal, timed = _played(parts, sheet, counts, path)
    begin = min([0.0, *(note.start for note in found)])  # grace notes before the first beat
    notes, remarks = repaired_notes(found, counts, sheet.remarks, path, lambda time: time - begin)
    moves = tuple(PedalEvent(time - begin, value) for time, value in pedal)
    bars = tuple(bar.moved(lambda time: time - begin) for bar in timed)
    return Score(notes, moves, sheet.title or title_of(path), remarks, listed, bars)


@dataclass(frozen=True, slots=True)
class _Written:
    """A note as written, in a bar, its times in quarters.

    A grace note is the `grace`-th before its beat. `tied` and `ties` say whether a tie leads to it
    and on from it.
    """

    bar: int
    start: float
    end: float
    pitch: int
    velocity: int
    finger: Finger | None
    hands: tuple[int, ...]
    grace: int
    tied: bool
    ties: bool


@dataclass(frozen=True, slots=True)
class _Move:
    """A motion of the pedal to a value, in a bar, at a time in quarters."""

    bar: int
    quarter: float
    value: int


_T = TypeVar("_T", _Written, _Move)


@dataclass(frozen=True, slots=True)
class _Part:
    """A part: its notes and motions of the pedal, in the order of their bars."""

    name: str
    notes: list[_Written]
    pedal: list[_Move]


@dataclass(frozen=True, slots=True)
class _Bar:
    """A measure or a part of one, with its start and end in quarters, and its number.

    A beat is `1 / beat_type` of a whole note.
    """

    measure: int
    start: float
    end: float
    number: int
    beat_type: int

    @property
    def beats(self) -> list[float]:
        """The times at which beats begin, in quarters; the first is `start`."""
        count = max(1, round((self.end - self.start) * self.beat_type / 4))
        if count > _MOST_BEATS:
            return []
        return [self.start + 4 * beat / self.beat_type for beat in range(count)]


@dataclass(frozen=True, slots=True)
class _Sheet:
    """The written music, with times in quarters.

    `sections`, each from one bar up to another, are played one after the other; `tempos` say from
    when on a quarter lasts how long.
    """

    title: str
    parts: list[_Part]
    bars: list[_Bar]
    sections: list[tuple[int, int]]
    tempos: dict[float, float]
    remarks: list[str]


def _track(number: int, part: _Part) -> Track:
    pitches = [note.pitch for note in part.notes if not note.tied] or [part.notes[0].pitch]
    return Track(number, part.name, part.name, None, len(pitches), min(pitches), max(pitches))


def _played(
    parts: Mapping[int, _Part], sheet: _Sheet, counts: Counter[str], path: Path
) -> tuple[list[RawNote], list[tuple[float, int]], list[Bar]]:
    """The notes, the motions of the pedal (time [s], value) and the bars.

    `parts` are those that are played, by their numbers.
    """
    at = _clock(sheet)
    found: list[RawNote] = []
    pedal: list[tuple[float, int]] = []
    bars: list[Bar] = []
    tied: dict[tuple[int, int, float], RawNote] = {}  # by part, pitch and end
    now = 0.0
    for first, beyond in sheet.sections:
        start, end = sheet.bars[first].start, sheet.bars[beyond - 1].end
        later = now - at(start)
        for number, part in parts.items():
            for note in _within(part.notes, first, beyond):
                if not LOWEST_PITCH <= note.pitch <= HIGHEST_PITCH:
                    counts["outside"] += not note.tied
                    continue
                sounding = _sounding(note, at, later)
                sounding.tracks = (number,)
                before = tied.get((number, note.pitch, sounding.start)) if note.tied else None
                if before is None:
                    found.append(sounding)
                else:
                    before.end, sounding = sounding.end, before
                if note.ties:
                    tied[number, note.pitch, sounding.end] = sounding
            for move in _within(part.pedal, first, beyond):
                pedal.append((max(0.0, round(at(move.quarter) + later, 9)), move.value))
        section = sheet.bars[first:beyond]
        for bar in section:
            begin, *beats = (round(at(beat) + later, 9) for beat in (bar.start, *bar.beats))
            bars.append(Bar(begin, bar.number, tuple(beats), bar.beat_type))
        now += at(end) - at(start)
        if max(len(found), len(bars), len(pedal)) > _MAX_PLAYED:
            what = f"over {_MAX_PLAYED} notes, bars or moves of the pedal with all repeats"
            raise CadenzaError(f"{path}: {what}, too many")
    return found, pedal, bars


def _clock(sheet: _Sheet) -> Callable[[float], float]:
    """A function from a time on the sheet [quarters] to time [s], by the tempos."""
    tempos = dict(sorted(({0.0: _SECONDS_PER_QUARTER} | sheet.tempos).items()))
    quarters = np.array([*tempos, 1e6])
    seconds = np.cumsum([0.0, *np.diff(quarters) * list(tempos.values())])
    return lambda quarter: float(np.interp(quarter, quarters, seconds))


def _within(items: list[_T], first: int, beyond: int) -> list[_T]:
    """The `items`, sorted by bar, from one bar up to another."""
    begin, end = (bisect_left(items, bar, key=lambda item: item.bar) for bar in (first, beyond))
    return items[begin:end]


def _sounding(note: _Written, at: Callable[[float], float], later: float) -> RawNote:
    begin = at(note.start) + later - note.grace * _GRACE
    stop = begin + _GRACE if note.grace else at(note.end) + later
    # Rounded, so that what ends where another begins does so exactly.
    times = round(begin, 9), round(stop, 9)
    return RawNote(*times, note.pitch, note.velocity, True, note.finger, hands=note.hands)


def _sheet(root: ElementTree.Element, path: Path) -> _Sheet:
    symbols = partitura_module("score")
    load_musicxml = partitura_module("io.importmusicxml").load_musicxml
    try:
        remarks = mend(root)
        marks = {part.get("id", ""): marks_of(part) for part in root.iterfind("part")}
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            score = load_musicxml(io.BytesIO(ElementTree.tostring(root)))
            found = [part for part in score.parts if part.last_point != part.first_point]
            timelines = _timelines([(part, marks[part.id]) for part in found], symbols)
            longest = max(timelines, key=lambda each: len(each.units), default=None)
            bars = _bars(longest) if longest else []
            parts = [_part(each, bars, symbols) for each in timelines]
            tempos = _tempos(timelines)
    except Exception as error:  # the library checks little and raises almost anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise CadenzaError(f"{path}: cannot be read as MusicXML ({reason})") from error
    title = printable(score.work_title or score.movement_title or score.title or "")
    sections, unclear = _sections(longest.marks if longest else Marks())
    return _Sheet(title, parts, bars, sections, tempos, [*remarks, *unclear])


@dataclass(frozen=True, slots=True)
class _Timeline:
    """A part as partitura has it, with the marks that it leaves out.

    Its measures begin at `units` and `own_quarters` of its own, and at `quarters` of the sheet:
    where a measure is not as long in all parts, the next begins when it has ended in all of them.
    """

    part: Any
    marks: Marks
    units: list[int]
    own_quarters: list[float]
    own_quarter: Callable[[Any], Any]
    quarters: list[float]

    def quarter(self, measure: int, unit: int) -> float:
        """The time on the sheet [quarters] of `unit` in a measure."""
        return self.quarters[measure] + (float(self.own_quarter(unit)) - self.own_quarters[measure])


def _timelines(parts: list[tuple[Any, Marks]], symbols: Any) -> list[_Timeline]:
    lengths: list[float] = []
    quarters = [0.0]
    timelines = []
    for part, marks in parts:
        measures = list(part.iter_all(symbols.Measure))
        own_quarter = part.quarter_map
        units = [measure.start.t for measure in measures]
        begin, end = own_quarter(units), own_quarter([measure.end.t for measure in measures])
        own_lengths = (end - begin).tolist()
        lengths = [max(pair) for pair in zip_longest(lengths, own_lengths, fillvalue=0.0)]
        timelines.append(_Timeline(part, marks, units, begin.tolist(), own_quarter, quarters))
    quarters += accumulate(lengths)
    return timelines


def _tempos(timelines: list[_Timeline]) -> dict[float, float]:
    """Time [quarters] -> length of a quarter [s] from then on."""
    tempos: dict[float, float] = {}
    for each in reversed(timelines):  # so that the first part has the last word
        for (measure, into), seconds in each.marks.tempos:
            quarter = each.quarter(measure, max(each.units[measure] + into, each.units[0]))
            if math.isfinite(quarter):  # it is not past the end
                tempos[round(quarter, 9)] = seconds
    return tempos


def _bars(part: _Timeline) -> list[_Bar]:
    """The bars of the part with most measures."""
    places = [place for place, _ in part.marks.bars]
    begin = [part.quarter(measure, part.units[measure] + into) for measure, into in places]
    end = [*begin[1:], part.quarters[-1]]
    return [
        _Bar(
            measure,
            begin[i],
            end[i],
            part.marks.numbers[measure],
            _beat_type(end[i] - begin[i], part.marks.beat_types[measure]),
        )
        for i, (measure, _) in enumerate(places)
    ]


def _beat_type(quarters: float, beat_type: int) -> int:
    """The type of beat of a bar: `beat_type`, or a finer one where that does not fill it."""
    finer = (each for each in sorted(BEAT_TYPES) if each >= beat_type)
    filling = (each for each in finer if abs(math.remainder(quarters * each / 4, 1)) < _ROUNDING)
    return next(filling, beat_type)


def _part(timeline: _Timeline, bars: list[_Bar], symbols: Any) -> _Part:
    part = timeline.part
    written = list(part.iter_all(symbols.Note, include_subclasses=True))
    loudness = [
        (direction.start.t, VELOCITIES[direction.text])
        for direction in part.iter_all(symbols.ConstantLoudnessDirection)
        if direction.text in VELOCITIES
    ]
    marked = [time for time, _ in loudness]
    shifts = [(each.start.t, each.chromatic or 0) for each in part.iter_all(symbols.Transposition)]
    shifted = [time for time, _ in shifts]
    staves = {note.staff for note in written}
    are_hands = staves == _HANDS or (timeline.marks.staves == len(_HANDS) and staves < _HANDS)
    notes = []
    for note in written:
        start = note.start.t
        mark, shift = bisect_right(marked, start), bisect_right(shifted, start)
        marks = timeline.marks.notes[note.doc_order]
        begin = timeline.quarter(marks.measure, start)
        notes.append(
            _Written(
                bar=_bar_at(bars, marks.measure, begin),
                start=begin,
                end=timeline.quarter(marks.measure, note.end.t),
                pitch=int(note.midi_pitch) + (shifts[shift - 1][1] if shift else 0),
                velocity=marks.velocity or (loudness[mark - 1][1] if mark else _UNMARKED),
                finger=_finger(note, symbols) if are_hands else None,
                hands=(note.staff - 1,) if are_hands else (),
                grace=_before_beat(note, symbols),
                tied=marks.tied,
                ties=marks.ties,
            )
        )
    pedal = []
    for down in part.iter_all(symbols.SustainPedalDirection):
        measure = bisect_right(timeline.units, down.start.t) - 1
        pedal.append(_move(timeline, bars, measure, down.start.t, _PEDAL_DOWN))
        if down.end is not None:  # up before what begins there
            measure = max(0, bisect_left(timeline.units, down.end.t) - 1)
            pedal.append(_move(timeline, bars, measure, down.end.t, _PEDAL_UP))
    return _Part(
        printable(part.part_name or ""),
        sorted(notes, key=lambda note: note.bar),
        sorted(pedal, key=lambda move: move.bar),
    )


def _move(timeline: _Timeline, bars: list[_Bar], measure: int, unit: int, value: int) -> _Move:
    quarter = timeline.quarter(measure, unit)
    return _Move(_bar_at(bars, measure, quarter), quarter, value)


def _bar_at(bars: list[_Bar], measure: int, quarter: float) -> int:
    """The index of the bar that is the measure, or the part of it, at a time [quarters]."""
    near = quarter + _ROUNDING
    return bisect_right(bars, (measure, near), key=lambda bar: (bar.measure, bar.start)) - 1


def _finger(note: Any, symbols: Any) -> Finger | None:
    """The finger of a note, of the right hand on the upper staff, of the left one on the lower."""
    for sign in note.technical or ():
        if isinstance(sign, symbols.Fingering) and sign.fingering in _SIGNS:
            return Finger(hand=note.staff - 1, index=sign.fingering - 1)
    return None


def _before_beat(note: Any, symbols: Any) -> int:
    """The number of grace notes from this one to the note that they ornament; 0 for others."""
    count = 0
    while isinstance(note, symbols.GraceNote):
        note = note.grace_next
        count += 1
    return count


def _sections(marks: Marks) -> tuple[list[tuple[int, int]], list[str]]:
    """The sections in the order in which they are played, and remarks on signs not followed."""
    signs = [each for _, each in marks.bars]
    sections: list[tuple[int, int]] = []
    for bar in islice(played_order(signs), _MAX_PLAYED + 1):
        if sections and sections[-1][1] == bar:
            sections[-1] = sections[-1][0], bar + 1
        else:
            sections.append((bar, bar + 1))
    unplayed = set(range(len(signs))).difference(*(range(*section) for section in sections))
    remarks = (
        (without_goal(signs), "jump", "without a segno or coda to go to left out"),
        (marks.in_words, "jump", "in words, without a sign for playback, left out"),
        (len(unplayed), "bar", "passed over by all repeats and jumps"),
    )
    return sections, counted_remarks(remarks)
