"""MusicXML as a score: the parts of a sheet, played in their order."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from itertools import islice
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.music.formats.musicxml.bar_order import without_goal
from cadenza.music.formats.musicxml.bars import WrittenBar, bars_of
from cadenza.music.formats.musicxml.jumps import JUMPS, read_jumps
from cadenza.music.formats.musicxml.notes import WrittenNote, notes_of
from cadenza.music.formats.musicxml.pedal import (
    SOSTENUTO,
    SUSTAIN,
    Move,
    has_soft_pedal,
    pedal_moves,
    sostenuto_words,
    together,
)
from cadenza.music.formats.musicxml.tempo import tempo_marks
from cadenza.music.formats.musicxml.timeline import passes_of, timeline
from cadenza.music.formats.musicxml.tree import tree_of
from cadenza.music.formats.musicxml.unrolling import (
    Passage,
    played_notes,
    played_pedal,
    played_swings,
    sections,
    unrolled,
)
from cadenza.music.formats.titles import printable, title_of
from cadenza.music.repair import RawNote, counted_remarks, repaired_notes
from cadenza.music.score import Bar, PedalEvent, Score, Track, check_chosen
from cadenza.music.signs.realising import realised
from cadenza.music.signs.tempo_map import TempoMap
from cadenza.music.signs.tempo_marks import Swing, says_tempo

_DECIMALS = 9  # of times [s]: what ends where another begins does so exactly
_DRUM_CHANNEL = "10"
_TITLES = ("work/work-title", "movement-title", "credit[credit-type='title']/credit-words")


def read_musicxml(path: str | Path, tracks: Collection[int] = (), plain: bool = False) -> Score:
    """The piano score in a MusicXML file (.musicxml, .xml or, compressed, .mxl).

    Parts with pitched notes are tracks, see `Score.tracks`; all but drums are played together, or
    only `tracks`. Tied notes are one. Repeats, endings, da capo and dal segno are followed as the
    part with most measures has them, the first of those. Times follow the tempos given for playback
    and metronome marks, velocities what is given for playback or else the dynamic marks. Of a
    part on two staves hands and fingering are taken over: the upper staff is the right hand's. What
    cannot be played on one piano is repaired as by `read_midi`.

    Args:
        path: the file.
        tracks: the numbers of the tracks to be played; all by default.
        plain: plays no signs, such as trills and hairpins.

    Raises:
        CadenzaError: no such file, not MusicXML, damaged, too large, without notes, or
            without one of `tracks`.
    """
    path = Path(path)
    root = tree_of(path)
    with _named(path):
        sheet = _sheet(root, plain)
    listed = tuple(part.track for part in sheet.parts)
    check_chosen(tracks, listed, path)
    parts = [part for part in sheet.parts if not tracks or part.track.number in tracks]
    counts = Counter(drums=0 if tracks else sheet.drums)
    with _named(path):
        found, pedal, timed = _played(parts, sheet, counts)
    begin = min([0.0, *(note.start for note in found)])  # grace notes before the first beat
    notes, remarks = repaired_notes(found, counts, sheet.remarks, path, lambda time: time - begin)
    moves = tuple(PedalEvent(max(0.0, time - begin), value) for time, value in pedal)
    bars = tuple(bar.moved(lambda time: time - begin) for bar in timed)
    return Score(notes, moves, sheet.title or title_of(path), remarks, listed, bars)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Begins the messages of errors with the file."""
    try:
        yield
    except CadenzaError as error:
        raise CadenzaError(f"{path}: {error}") from error


def _played(
    parts: Sequence[_Part], sheet: _Sheet, counts: Counter[str]
) -> tuple[list[RawNote], list[tuple[float, int]], list[Bar]]:
    """The notes, the motions of the pedal (time [s], value) and the bars as they are played."""
    passages, bars = sheet.passages, sheet.bars
    tempo = sheet.tempo.played(sections(passages))
    signed = [note for p in parts for note in played_notes(p.notes, bars, passages, counts)]
    swings = played_swings(sheet.swings, bars, passages)
    hands = {note.signed.written: note.hands for part in parts for note in part.notes}
    found = [
        RawNote(
            round(note.start, _DECIMALS),
            round(note.end, _DECIMALS),
            note.pitch,
            note.velocity,
            True,
            note.of.finger if note.pitch == note.of.pitch else None,
            (note.of.part,),
            hands[note.of.written],
        )
        for note in realised(signed, tempo, swings)
    ]
    for part in parts:
        _hold(found, part.track.number, _timed(played_pedal(part.sostenuto, bars, passages), tempo))
    pedal = together(played_pedal(part.pedal, bars, passages) for part in parts)
    return found, _timed(pedal, tempo), _bars(passages, tempo)


def _timed(moves: Sequence[tuple[Fraction, int]], tempo: TempoMap) -> list[tuple[float, int]]:
    """The motions of a pedal in seconds."""
    times = [(tempo.onsets if value else tempo.ends)([place])[0] for place, value in moves]
    return [
        (round(float(time), _DECIMALS), value)
        for time, (_, value) in zip(times, moves, strict=True)
    ]


def _hold(notes: Iterable[RawNote], track: int, moves: Sequence[tuple[float, int]]) -> None:
    """Has the sostenuto pedal of a track hold the notes that sound when it goes down."""
    down = [time for time, value in moves if value]
    up = [time for time, value in moves if not value]
    for note in notes if down else ():
        before = bisect_left(down, note.end) - 1
        if track in note.tracks and before >= 0 and down[before] >= note.start:
            end = bisect_right(up, down[before])
            note.end = max(note.end, up[end] if end < len(up) else note.end)


def _bars(passages: Sequence[Passage], tempo: TempoMap) -> list[Bar]:
    """The bars as they are played, in seconds."""
    beats = [
        [beat + passage.later for beat in (passage.bar.begin, *passage.bar.beats)]
        for passage in passages
    ]
    times = iter(
        np.round(tempo.onsets([place for bar in beats for place in bar]), _DECIMALS).tolist()
    )
    return [
        Bar(next(times), p.bar.number, tuple(islice(times, len(bar) - 1)), p.bar.beat_type)
        for p, bar in zip(passages, beats, strict=True)
    ]


@dataclass(frozen=True, slots=True)
class _Part:
    """A part with notes: these and the motions of its pedals, of each bar."""

    track: Track
    notes: list[WrittenNote]
    pedal: list[Move]
    sostenuto: list[Move]


@dataclass(frozen=True, slots=True)
class _Sheet:
    """The written music; `drums` counts notes that are left out as such."""

    title: str
    parts: list[_Part]
    bars: list[WrittenBar]
    passages: list[Passage]
    tempo: TempoMap
    swings: list[Swing]
    drums: int
    remarks: list[str]


def _sheet(root: Element, plain: bool) -> _Sheet:
    counts = Counter[str]()
    music = root.findall("part")
    placed, begins = timeline(music)
    bars = bars_of(
        max(placed, key=lambda part: part[-1].measure if part else -1, default=[]), begins
    )
    read_jumps(placed, bars, begins)
    parts: list[_Part] = []
    first = 0
    for part, elements, listed in zip(music, placed, _listed(root, music), strict=True):
        is_drum = _drums(listed, part)
        notes = notes_of(elements, len(parts) + 1, first, is_drum, plain, counts)
        first += sum(each.element.tag == "note" for each in elements)
        if notes:
            track = _track(len(parts) + 1, printable(listed.findtext("part-name", "")), notes)
            pedals = (pedal_moves(elements, begins, pedal) for pedal in (SUSTAIN, SOSTENUTO))
            parts.append(_Part(track, notes, *pedals))
    found = tempo_marks(placed, begins)
    title = next((text for each in _TITLES if (text := printable(root.findtext(each, "")))), "")
    marks = filter(says_tempo, found.marks) if plain else found.marks
    tempo, swings = TempoMap.of(marks, begins[-1]), [] if plain else found.swings
    passages, lost = unrolled(bars), without_goal([bar.signs for bar in bars])
    unplayed = len({*range(len(bars))} - {passage.index for passage in passages})
    remarks = counted_remarks(
        (
            (counts["fingering"], "unreadable fingering", "left out"),
            (found.impossible, "impossible tempo", "left out"),
            (found.unclear, "metronome mark without a tempo", "left out"),
            (counts["microtone"], "microtone", "rounded to a semitone"),
            (counts["unpitched"], "unpitched note", "left out"),
            (counts["unreadable"], "note", "with an unreadable <step> or <octave> left out"),
            *_unread(root),
            (lost, "jump", "without a segno or coda to go to left out"),
            (unplayed, "bar", "passed over by all repeats and jumps"),
        )
    )
    if has_soft_pedal(root):
        remarks.append("the soft pedal is left out")
    return _Sheet(title, parts, bars, passages, tempo, swings, counts["drums"], remarks)


def _track(number: int, name: str, notes: Sequence[WrittenNote]) -> Track:
    struck = [note.signed.pitch for note in notes if not note.tied] or [notes[0].signed.pitch]
    return Track(number, name, name, None, len(struck), min(struck), max(struck))


def _listed(root: Element, parts: Iterable[Element]) -> list[Element]:
    """What the list of parts says of each part; of several with one name, in their order."""
    entries: defaultdict[str, list[Element]] = defaultdict(list)
    for entry in root.iterfind("part-list/score-part"):
        entries[entry.get("id", "")].append(entry)
    found = []
    for part in parts:
        same = entries[part.get("id", "")]
        found.append(same.pop(0) if same else Element("score-part"))
    return found


def _drums(listed: Element, part: Element) -> Callable[[Element], bool]:
    """A function that says whether a note of a part is played by drums.

    What is said for MIDI tells it, or where there is nothing, the first clef.
    """
    channels = {
        each.get("id", ""): each.findtext("midi-channel", "").strip() == _DRUM_CHANNEL
        or each.find("midi-unpitched") is not None
        for each in listed.iterfind("midi-instrument")
    }
    is_clef = part.findtext("measure/attributes/clef/sign", "").strip() == "percussion"
    usual = next(iter(channels.values()), is_clef)

    def is_drum(note: Element) -> bool:
        instrument = note.find("instrument")
        return usual if instrument is None else channels.get(instrument.get("id", ""), usual)

    return is_drum


def _unread(root: Element) -> Iterator[tuple[int, str, str]]:
    """Yields the numbers of signs that are left out, what they are, and that they are."""
    repeats = sum(sign.get("type") == "start" for sign in root.iter("measure-repeat"))
    yield repeats, "bar-repeat sign", "left out"
    yield sostenuto_words(root), "sostenuto pedal", "left out, as only words tell of it"
    of_passes = (sound for sound in root.iter("sound") if passes_of(sound))
    count = sum(len(sound) > 0 or not JUMPS.issuperset(sound.keys()) for sound in of_passes)
    yield count, "sound", "for single passes left out"
