"""MusicXML as a score: the parts of a sheet, played in their order."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from operator import itemgetter
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from cadenza.errors import CadenzaError, errors_in
from cadenza.music.formats.musicxml.bars import Passage, Unrolled, WrittenBar, bars_of, without_goal
from cadenza.music.formats.musicxml.jumps import JUMPS, read_jumps
from cadenza.music.formats.musicxml.marks import (
    PEDALS,
    Move,
    TempoMarks,
    has_soft_pedal,
    pedal_moves,
    sostenuto_words,
)
from cadenza.music.formats.musicxml.notes import SheetNote, notes_of
from cadenza.music.formats.musicxml.timeline import (
    ZERO,
    Placed,
    number,
    number_or_none,
    passes_of,
    timeline,
)
from cadenza.music.formats.musicxml.tree import tree_of
from cadenza.music.formats.source import printable, title_of
from cadenza.music.repair import RawNote, counted_remarks, merged_pedal, repaired_notes
from cadenza.music.score import Bar, PedalEvent, Score, Track, check_chosen
from cadenza.music.signs.realising import realised
from cadenza.music.signs.tempo_map import AS_USUAL, Swing, TempoMap, says_tempo

_DECIMALS = 9  # decimals of times [s]: a note that ends where another begins does so exactly
_DRUM_CHANNEL = 10
_AUDIBLE = Fraction(100)  # per cent of the volume
_MAX_PARTS = 500  # an orchestra has some 50
_TITLES = (
    "work/work-title",
    "movement-title",
    "credit[credit-type='title']/credit-words",
    "credit[@page='1']/credit-words[@justify='center'][@valign='top']",  # MuseScore, without a type
)
_COMPOSERS = (
    "identification/creator[@type='composer']",
    "credit[credit-type='composer']/credit-words",
    "credit[@page='1']/credit-words[@justify='right']",
)


def read_musicxml(path: str | Path, tracks: Collection[int] = (), plain: bool = False) -> Score:
    """The piano score in a MusicXML file (.musicxml, .xml or, compressed, .mxl).

    Parts with pitched notes are tracks, see `Score.tracks`; all but drums are played together, or
    only `tracks`. Tied notes are one. Repeats, endings, da capo and dal segno are followed as the
    part with most measures has them, the first of those. Times follow the tempos given for playback
    and metronome marks, velocities what is given for playback or else the dynamic marks. Of a part
    on two staves hands and fingering are taken over: the upper staff is the right hand's. What
    cannot be played on one piano is repaired as by `read_midi`. Without signs, such as trills and
    hairpins, if `plain`. Raises CadenzaError if the file is not there, no MusicXML, damaged or too
    large, or has no notes, or not one of `tracks`.
    """
    path = Path(path)
    root = tree_of(path)
    with errors_in(path):
        return _score(root, tracks, plain, title_of(path))


def _score(root: Element, tracks: Collection[int], plain: bool, title: str) -> Score:
    """The score in a document; without a title in it, it has the `title`."""
    music, counts = root.findall("part"), Counter[str]()
    if len(music) > _MAX_PARTS:
        raise CadenzaError(f"over {_MAX_PARTS} parts, too large for a song")
    placed, begins = timeline(music)
    longest = max(placed, key=lambda part: part[-1].measure if part else -1, default=[])
    bars = bars_of(longest, begins)
    read_jumps(placed, bars, begins)
    sheet, tempo_marks = Unrolled(bars), TempoMarks(placed, begins, counts)
    all_parts = list(_parts(root, placed, begins, plain, counts))
    remarks = tuple(_remarks(root, counts, bars, sheet.passages))
    listed = tuple(part.track for part in all_parts)
    check_chosen(tracks, listed)
    if tracks:
        counts["drums"] = 0
    parts = [part for part in all_parts if not tracks or part.track.number in tracks]

    marks = filter(says_tempo, tempo_marks.marks) if plain else tempo_marks.marks
    tempo = TempoMap.of(marks, begins[-1]).played(sheet.sections())
    swings = sheet.swings(() if plain else tempo_marks.swings)
    notes = _notes(parts, sheet, tempo, swings, counts)
    begin = min([0.0, *(note.start for note in notes)])  # grace notes before the first beat
    score_notes, remarks = repaired_notes(notes, counts, remarks, lambda time: time - begin)
    pedals = (
        (place, part.track.number, value)
        for part in parts
        for place, value in sheet.pedal(part.pedal)
    )
    pedal = _timed(merged_pedal(sorted(pedals, key=itemgetter(0))), tempo)
    moves = (PedalEvent(max(0.0, time - begin), value) for time, value in pedal)
    score_bars = (
        bar.moved(lambda time: time - begin)
        for bar in _bars(sheet.passages, tempo, tempo_marks.words, tempo_marks.fermatas)
    )
    title, composer = _first_text(root, _TITLES) or title, _first_text(root, _COMPOSERS)
    return Score(score_notes, tuple(moves), title, remarks, listed, tuple(score_bars), composer)


def _first_text(root: Element, places: Iterable[str]) -> str:
    """The first text in some places of a document; empty if there is none."""
    return next((text for place in places if (text := printable(root.findtext(place, "")))), "")


def _notes(
    parts: Sequence[_Part],
    sheet: Unrolled,
    tempo: TempoMap,
    swings: Iterable[Swing],
    counts: Counter[str],
) -> list[RawNote]:
    """The notes of the parts as they sound; those that no key plays are added to `counts`."""
    signed = [note for part in parts for note in sheet.notes(part.notes, counts)]
    notes = [
        RawNote(
            round(note.start, _DECIMALS),
            round(note.end, _DECIMALS),
            note.pitch,
            round(note.velocity),
            True,
            note.of.finger if note.pitch == note.of.pitch else None,
            (note.of.part,),
            note.of.hands,
        )
        for note in realised(signed, tempo, swings)
    ]
    of_part: defaultdict[int, list[RawNote]] = defaultdict(list)
    for raw in notes:
        of_part[raw.tracks[0]].append(raw)
    for part in parts:
        moves = _timed(sheet.pedal(part.sostenuto), tempo)
        _hold(of_part[part.track.number], moves)
    return notes


def _timed(moves: Iterable[tuple[Fraction, int]], tempo: TempoMap) -> list[tuple[float, int]]:
    """The motions of a pedal in seconds."""
    return [
        (round(float((tempo.onsets if value else tempo.ends)([place])[0]), _DECIMALS), value)
        for place, value in moves
    ]


def _hold(notes: Iterable[RawNote], moves: Sequence[tuple[float, int]]) -> None:
    """Have the sostenuto pedal hold those notes of its part that sound when it goes down."""
    down = [time for time, value in moves if value]
    up = [time for time, value in moves if not value]
    for note in notes if down else ():
        index = bisect_left(down, note.end) - 1
        if index >= 0 and down[index] >= note.start:
            end = bisect_right(up, down[index])
            note.end = max(note.end, up[end] if end < len(up) else note.end)


def _bars(
    passages: Iterable[Passage],
    tempo: TempoMap,
    words: Mapping[Fraction, str],
    fermatas: Iterable[Fraction],
) -> Iterator[Bar]:
    """Yield the bars as they are played, in seconds, with `words` of tempo and `fermatas`.

    These are by quarters.
    """
    marked = sorted(words), sorted(fermatas)
    for passage in passages:
        bar, later = passage.bar, passage.later
        of_words, of_fermatas = (
            places[bisect_left(places, bar.begin) : bisect_left(places, bar.end)]
            for places in marked
        )
        (begin,), beats, times, held = (
            tuple(np.round(tempo.onsets([place + later for place in each]), _DECIMALS).tolist())
            for each in ([bar.begin], bar.beats, of_words, of_fermatas)
        )
        timed = tuple(zip(times, (words[place] for place in of_words), strict=True))
        yield Bar(begin, bar.number, beats, bar.beat_type, bar.key, timed, held)


@dataclass(frozen=True, slots=True)
class _Part:
    """A part with notes: these and the motions of its pedals, of each bar."""

    track: Track
    notes: list[SheetNote]
    pedal: list[Move]
    sostenuto: list[Move]


def _parts(
    root: Element,
    placed: Sequence[Sequence[Placed]],
    begins: Sequence[Fraction],
    plain: bool,
    counts: Counter[str],
) -> Iterator[_Part]:
    """Yield the parts with notes; other notes are added to `counts`."""
    music, track_number = root.findall("part"), 1
    for part, elements, listed in zip(music, placed, _listed(root, music), strict=True):
        notes = notes_of(elements, track_number, _silence(listed, part, elements), plain, counts)
        if notes:
            track = _track(track_number, printable(listed.findtext("part-name", "")), notes)
            yield _Part(track, notes, *(pedal_moves(elements, begins, p) for p in PEDALS))
            track_number += 1


def _remarks(
    root: Element, counts: Counter[str], bars: Sequence[WrittenBar], passages: Sequence[Passage]
) -> Iterator[str]:
    lost = without_goal([bar.signs for bar in bars])
    unplayed = len(bars) - len({passage.index for passage in passages})
    repeats = sum(sign.get("type") == "start" for sign in root.iter("measure-repeat"))
    lines = (*root.iter("glissando"), *root.iter("slide"))
    slides = sum(line.get("type") == "start" for line in lines)
    sounds = [
        sound
        for sound in root.iter("sound")
        if passes_of(sound) and (len(sound) or not JUMPS.issuperset(sound.keys()))
    ]
    yield from counted_remarks(
        (
            (counts["fingering"], "unreadable fingering", "left out"),
            (counts["impossible"], "impossible tempo", "left out"),
            (counts["unclear"], "metronome mark without a tempo", "left out"),
            (counts["usual"], "tempo word", AS_USUAL),
            (counts["microtone"], "microtone", "rounded to a semitone"),
            (counts["unpitched"], "unpitched note", "left out"),
            (counts["silent"], "note", "of no volume left out"),
            (counts["slash"], "note", "that a slash stands for left out"),
            (counts["other staff"], "note", "of an ossia, or on a staff for reference, left out"),
            (counts["unreadable"], "note", "with an unreadable <step> or <octave> left out"),
            (repeats, "bar-repeat sign", "left out"),
            (sostenuto_words(root), "sostenuto pedal", "left out, as only words tell of it"),
            (len(sounds), "sound", "for single passes left out"),
            (sum(1 for _ in root.iter("harmony")), "chord symbol", "left out"),
            (sum(1 for _ in root.iter("figured-bass")), "figured bass", "left out"),
            (slides, "glissando", "left out"),
            (lost, "jump", "without a segno or coda to go to left out"),
            (unplayed, "bar", "passed over by all repeats and jumps"),
        )
    )
    if has_soft_pedal(root):
        yield "the soft pedal is left out"


def _track(at: int, name: str, notes: Sequence[SheetNote]) -> Track:
    struck = [note.signed.pitch for note in notes if not note.tied] or [notes[0].signed.pitch]
    return Track(at, name, name, None, len(struck), min(struck), max(struck))


def _listed(root: Element, parts: Iterable[Element]) -> list[Element]:
    """What the list of parts says of each part; of several with one name, in their order."""
    entries: defaultdict[str, list[Element]] = defaultdict(list)
    for entry in root.iterfind("part-list/score-part"):
        entries[entry.get("id", "")].append(entry)
    entries_of_parts = []
    for part in parts:
        matches = entries[part.get("id", "")]
        entries_of_parts.append(matches.pop(0) if matches else Element("score-part"))
    return entries_of_parts


def _silence(listed: Element, part: Element, elements: Iterable[Placed]) -> Callable[[Placed], str]:
    """A function that says why the instrument of a note is not heard, if it is not.

    That is "drums" where what is said for MIDI tells it, or where there is nothing, the first clef;
    and "silent" where the volume is 0, from the beginning or from a sound for playback on.
    """
    is_ossia = printable(listed.findtext("part-name", "")).lower().startswith("ossia")
    drums: dict[str, bool] = {}
    volumes: defaultdict[str, list[tuple[Fraction, Fraction]]] = defaultdict(list)
    for each in listed.iterfind("midi-instrument"):
        channel = number(each.findtext("midi-channel"))
        is_drum = channel == _DRUM_CHANNEL or each.find("midi-unpitched") is not None
        drums[each.get("id", "")] = is_drum
        volumes[each.get("id", "")].append((ZERO, number(each.findtext("volume"), _AUDIBLE)))
    for placed in elements:
        for sound in placed.sounds:
            for each in sound.iterfind("midi-instrument"):
                if (volume := number_or_none(each.findtext("volume"))) is not None:
                    volumes[each.get("id", "")].append((placed.sounds_at(sound), volume))
    for changes in volumes.values():
        changes.sort(key=itemgetter(0))
    is_clef = part.findtext("measure/attributes/clef/sign", "").strip() == "percussion"
    usual = next(iter(drums), "")

    def silence(placed: Placed) -> str:
        instrument = placed.element.find("instrument")
        name = usual if instrument is None else instrument.get("id", "")
        name = name if name in drums else usual
        if drums.get(name, is_clef):
            return "drums"
        if is_ossia:
            return "other staff"
        changes = volumes.get(name, [])
        count = bisect_right(changes, placed.quarter, key=itemgetter(0))
        return "silent" if count and changes[count - 1][1] == 0 else ""

    return silence
