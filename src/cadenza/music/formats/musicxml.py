"""MusicXML, plain or compressed, as notation programs export it."""

from __future__ import annotations

import html
import io
import re
import sys
import warnings
import zipfile
from bisect import bisect_left, bisect_right
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.formats.musicxml_mending import mended
from cadenza.music.formats.source import read_bytes
from cadenza.music.formats.titles import printable, title_of
from cadenza.music.repair import Sounding, repaired, repairs
from cadenza.music.score import (
    HIGHEST_PITCH,
    LOWEST_PITCH,
    Bar,
    Note,
    PedalEvent,
    Score,
    check_length,
)
from cadenza.music.tracks import Track, check_chosen

MAX_XML_BYTES = 16 * 2**20
# A long sonata has a tenth of these. Some cost the library time by their square.
MOST = {
    b"<": 800_000,
    b"<note": 40_000,
    b"<grace": 5_000,
    b"<words": 3_000,
    b"<repeat": 1_000,
    b"<ending": 1_000,
}
_MAX_PLAYED = 100_000  # notes or bars, with repeats
_SECONDS_PER_QUARTER = 0.5  # until the file says otherwise, as in MIDI
_GRACE = 0.1  # [s] that a grace note lasts, before the beat
_VELOCITIES = {"ppp": 16, "pp": 33, "p": 49, "mp": 64, "mf": 80, "f": 96, "ff": 112, "fff": 126}
_UNMARKED = 80  # velocity
_PEDAL_DOWN, _PEDAL_UP = 127, 0
_SIGNS = range(1, 6)  # of fingers
_T = TypeVar("_T")


def read_musicxml(path: str | Path, tracks: Collection[int] = ()) -> Score:
    """The piano score in a MusicXML file (.musicxml, .xml or, compressed, .mxl).

    Parts with pitched notes are tracks, see `Score.tracks`; all are played together, or only
    `tracks`. Tied notes are one. Repeats, endings, da capo and dal segno are followed as the first
    part has them. Times follow the tempos given for playback (`<sound tempo>`), velocities the
    dynamic markings. Grace notes last 0.1 s before the beat; signs of other ornaments are not
    played. Of a part on two staves the fingering is taken over, that of the upper staff for the
    right hand. What cannot be played on one piano is repaired as by `read_midi`.

    Raises:
        CadenzaError: no such file, not MusicXML, damaged, too large, without notes, without one of
            `tracks`, or over an hour long.
    """
    path = Path(path)
    sheet = _sheet(_xml(path), path)
    parts = [part for part in sheet.parts if part.notes]
    listed = tuple(_track(number, part) for number, part in enumerate(parts, start=1))
    check_chosen(tracks, listed, path)
    if tracks:
        parts = [parts[number - 1] for number in sorted(set(tracks))]

    counts = Counter[str]()
    found, pedal, timed = _played(parts, sheet, counts, path)
    begin = min([0.0, *(note.start for note in found)])  # grace notes before the first beat
    notes = tuple(
        Note(note.start - begin, note.end - begin, note.pitch, note.velocity, note.finger)
        for note in repaired(found, counts)
    )
    remarks = (*sheet.remarks, *repairs(counts))
    if not notes:
        why = f" left ({'; '.join(remarks)})" if remarks else ""
        raise CadenzaError(f"{path}: there are no notes{why}; choose another file")
    moves = tuple(PedalEvent(time - begin, value) for time, value in pedal)
    bars = tuple(Bar(time - begin, number) for time, number in timed)
    return Score(notes, moves, sheet.title or title_of(path), remarks, listed, bars)


@dataclass(frozen=True, slots=True)
class _Written:
    """A note as written, its times in quarters; a grace note is the `grace`-th before its beat."""

    start: float
    end: float
    pitch: int
    velocity: int
    finger: Finger | None
    grace: int


@dataclass(frozen=True, slots=True)
class _Part:
    name: str
    notes: list[_Written]  # in the order of their starts
    pedal: list[tuple[float, int]]  # when, in quarters, it moves where


@dataclass(frozen=True, slots=True)
class _Sheet:
    """What is written, times in quarters.

    `sections` are played one after the other; `tempos` say from when on a quarter lasts how long.
    `bars` are when bars begin, and their numbers.
    """

    title: str
    parts: list[_Part]
    sections: list[tuple[float, float]]
    tempos: dict[float, float]
    bars: list[tuple[float, int]]
    remarks: list[str]


def _track(number: int, part: _Part) -> Track:
    pitches = [note.pitch for note in part.notes]
    return Track(number, part.name, part.name, None, len(pitches), min(pitches), max(pitches))


def _played(
    parts: list[_Part], sheet: _Sheet, counts: Counter[str], path: Path
) -> tuple[list[Sounding], list[tuple[float, int]], list[tuple[float, int]]]:
    """The notes, when [s] the pedal moves where, and when which bar begins, by sections."""
    at = _clock(sheet)
    check_length(sum(at(end) - at(start) for start, end in sheet.sections), f"{path}: the song")
    found: list[Sounding] = []
    pedal: list[tuple[float, int]] = []
    bars: list[tuple[float, int]] = []
    now = 0.0
    for start, end in sheet.sections:
        later = now - at(start)
        for part in parts:
            for note in _within(part.notes, start, end, lambda note: note.start):
                if LOWEST_PITCH <= note.pitch <= HIGHEST_PITCH:
                    found.append(_sounding(note, at, later))
                else:
                    counts["outside"] += 1
            for quarter, value in part.pedal:  # up where it ends, down where it begins
                if start < quarter < end or quarter == (start if value else end):
                    pedal.append((max(0.0, round(at(quarter) + later, 9)), value))
        section = _within(sheet.bars, start, end, lambda bar: bar[0])
        bars += [(round(at(quarter) + later, 9), number) for quarter, number in section]
        now += at(end) - at(start)
        if max(len(found), len(bars), len(pedal)) > _MAX_PLAYED:
            what = f"over {_MAX_PLAYED} notes, bars or moves of the pedal with all repeats"
            raise CadenzaError(f"{path}: {what}, too many")
    return found, pedal, bars


def _clock(sheet: _Sheet) -> Callable[[float], float]:
    """The time [s] of a quarter as written, by the tempos."""
    tempos = {min((start for start, _ in sheet.sections), default=0.0): _SECONDS_PER_QUARTER}
    tempos = dict(sorted((tempos | sheet.tempos).items()))
    quarters = np.array([*tempos, 1e6])
    seconds = np.cumsum([0.0, *np.diff(quarters) * list(tempos.values())])
    return lambda quarter: float(np.interp(quarter, quarters, seconds))


def _within(items: list[_T], start: float, end: float, time: Callable[[_T], float]) -> list[_T]:
    """Those of `items`, which are in the order of their times, from `start` on, before `end`."""
    return items[bisect_left(items, start, key=time) : bisect_left(items, end, key=time)]


def _sounding(note: _Written, at: Callable[[float], float], later: float) -> Sounding:
    begin = at(note.start) + later - note.grace * _GRACE
    stop = begin + _GRACE if note.grace else at(note.end) + later
    # Rounded, so that what ends where another begins does so exactly.
    times = round(begin, 9), round(stop, 9)
    return Sounding(*times, note.pitch, note.velocity, True, note.finger)


def _xml(path: Path) -> bytes:
    """The document, from its archive where it is compressed, if it is one that is safe to parse."""
    data = read_bytes(path, MAX_XML_BYTES)
    if data.startswith(b"PK"):
        data = _unpacked(data, path)
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        text = data.decode("utf-16", "replace")
        data = re.sub(r"^<\?xml[^>]*>", "", text).encode("utf-8", "replace")
    if not data.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"<") or b"\0" in data:
        raise CadenzaError(f"{path}: not a MusicXML file (it does not begin as XML)")
    if b"<!ENTITY" in data:
        raise CadenzaError(f"{path}: declares XML entities, which MusicXML does not use")
    for tag, most in MOST.items():
        if data.count(tag) > most:
            raise CadenzaError(
                f"{path}: too large for a song (over {most} times {tag.decode()} in its XML)"
            )
    return data


def _unpacked(data: bytes, path: Path) -> bytes:
    """The first document that the archive's table of contents names."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            with archive.open("META-INF/container.xml") as file:
                contents = file.read(2**16).decode("utf-8", "replace")
            named = re.search(r"""full-path\s*=\s*["']([^"']+)""", contents)
            if named is None:
                raise CadenzaError("its table of contents names no document")
            with archive.open(html.unescape(named[1])) as file:
                unpacked = file.read(MAX_XML_BYTES + 1)
    except Exception as error:  # damage shows in many ways
        reason = " ".join(str(error).split()) or type(error).__name__
        raise CadenzaError(f"{path}: the compressed MusicXML is damaged ({reason})") from error
    if len(unpacked) > MAX_XML_BYTES:
        raise CadenzaError(f"{path}: over {MAX_XML_BYTES >> 20} MiB unpacked, too large for a song")
    return unpacked


def _partitura() -> Any:
    """The library, without the sound font that it fetches where pyfluidsynth is installed."""
    hidden = "fluidsynth"
    before = sys.modules.get(hidden)
    sys.modules[hidden] = None  # type: ignore[assignment]  # makes its import fail
    try:
        import partitura.score
        from partitura.io.importmusicxml import load_musicxml
    finally:
        if before is None:
            del sys.modules[hidden]
        else:
            sys.modules[hidden] = before
    return partitura.score, load_musicxml


def _sheet(data: bytes, path: Path) -> _Sheet:
    symbols, load_musicxml = _partitura()
    try:
        data, mends = mended(data)
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            score = load_musicxml(io.BytesIO(data))
            lasting = [part for part in score.parts if part.last_point != part.first_point]
            tempos: dict[float, float] = {}
            for part in lasting:
                for tempo in part.iter_all(symbols.Tempo):
                    if 0 < (lasts := tempo.microseconds_per_quarter) < 1e9:
                        tempos.setdefault(float(part.quarter_map(tempo.start.t)), lasts / 1e6)
            parts = [_part(part, symbols) for part in lasting]
            sections, remarks = _sections(lasting[0], symbols) if parts else ([], [])
            bars = _bars(lasting[0], symbols) if parts else []
    except Exception as error:  # the library checks little and raises almost anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise CadenzaError(f"{path}: cannot be read as MusicXML ({reason})") from error
    title = printable(score.work_title or score.movement_title or score.title or "")
    return _Sheet(title, parts, sections, tempos, bars, [*mends, *remarks])


def _part(part: Any, symbols: Any) -> _Part:
    written = [
        note
        for note in part.iter_all(symbols.Note, include_subclasses=True)
        if note.tie_prev is None
    ]
    marks = [
        (direction.start.t, _VELOCITIES[direction.text])
        for direction in part.iter_all(symbols.ConstantLoudnessDirection)
        if direction.text in _VELOCITIES
    ]
    marked = [time for time, _ in marks]
    shifts = [(each.start.t, each.chromatic or 0) for each in part.iter_all(symbols.Transposition)]
    shifted = [time for time, _ in shifts]
    staves = {note.staff for note in written}
    quarters = part.quarter_map
    notes = []
    for note in written:
        start = note.start.t
        mark, shift = bisect_right(marked, start), bisect_right(shifted, start)
        notes.append(
            _Written(
                start=float(quarters(start)),
                end=float(quarters(start + note.duration_tied)),
                pitch=int(note.midi_pitch) + (shifts[shift - 1][1] if shift else 0),
                velocity=marks[mark - 1][1] if mark else _UNMARKED,
                finger=_finger(note, symbols) if staves == {1, 2} else None,
                grace=_before_beat(note, symbols),
            )
        )
    pedal = []
    for down in part.iter_all(symbols.SustainPedalDirection):
        pedal.append((float(quarters(down.start.t)), _PEDAL_DOWN))
        if down.end is not None:
            pedal.append((float(quarters(down.end.t)), _PEDAL_UP))
    return _Part(printable(part.part_name or ""), notes, pedal)


def _bars(part: Any, symbols: Any) -> list[tuple[float, int]]:
    """When they begin, in quarters, and their numbers; as printed, where that is a number."""
    return [
        (
            float(part.quarter_map(bar.start.t)),
            int(bar.name or "") if (bar.name or "").isdecimal() else bar.number,
        )
        for bar in part.iter_all(symbols.Measure)
    ]


def _finger(note: Any, symbols: Any) -> Finger | None:
    """The right hand's on the upper staff, the left hand's on the lower; the thumb's sign is 1."""
    for sign in note.technical or ():
        if isinstance(sign, symbols.Fingering) and sign.fingering in _SIGNS:
            return Finger(hand=note.staff - 1, index=sign.fingering - 1)
    return None


def _before_beat(note: Any, symbols: Any) -> int:
    """Of how many grace notes it is the first, up to the note that they ornament."""
    count = 0
    while isinstance(note, symbols.GraceNote):
        note = note.grace_next
        count += 1
    return count


def _sections(part: Any, symbols: Any) -> tuple[list[tuple[float, float]], list[str]]:
    """What is played in which order, in quarters, with a remark where repeats make no sense."""
    try:
        path = symbols.get_paths(part, all_repeats=True, ignore_leap_info=False)[0].path
        segments = symbols.get_segments(part)
        played = [(segments[name].start.t, segments[name].end.t) for name in path]
        remarks = []
    except Exception:  # more or other signs than the library knows
        played = [(part.first_point.t, part.last_point.t)]
        remarks = ["repeats that could not be followed are left out"]
    return [(float(part.quarter_map(s)), float(part.quarter_map(e))) for s, e in played], remarks
