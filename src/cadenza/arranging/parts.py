"""The notes of a song, divided into melody, bass and harmony.

From part to part the melody may move, and so may the bass: each part has a likeness to a melody,
and to a bass, in each stretch of the song. The best sequence of parts over the stretches is found
by a dynamic programme (Viterbi) that pays for every change.
"""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.arranging.likeness import CALLED_BASS, Line, likeness_by_name
from cadenza.music.score import CHORD_TOLERANCE, RELEASE_TIME, Note, Score, chords
from cadenza.music.viterbi import cheapest_sequence

Array = NDArray[np.float64]

TOGETHER = 0.04
"""Time within which notes begin at one moment [s]: people in a band are less exact than one."""
_MIN_STRETCH = 2.0  # [s] over which one part has the melody, or the bass
_CONTEXT = 4.0  # [s] before and after a stretch that count for it, too
_CHANGE = 4.0  # cost of melody or bass going to another part
_ABSENT_MELODY, _ABSENT_BASS = 3.0, 6.0  # cost of a part that has it and does not play
_FOLLOWS = 3.0  # by which a second voice is less like a melody
_CALLED, _LOW, _SEMITONES = 3.0, 40.0, 6.0  # a bass is called so; so much lower is worth 1


class SourceNote(NamedTuple):
    """A note of the song from `start` to `end` [s], and its role."""

    start: float
    end: float
    pitch: int
    velocity: int
    melody: bool
    bass: bool
    added: bool = False  # whether it sounded already, and is struck again
    hands: tuple[int, ...] = ()  # the hands that it is written for


@dataclass(frozen=True)
class _InstrumentPart:
    name: str
    instrument: str
    notes: tuple[Note, ...]


def sources_of(score: Score) -> list[SourceNote]:
    """The notes of all parts of a song; in each stretch, one part has the melody, one the bass.

    A score without tracks is one part, whose highest notes are the melody and whose lowest are the
    bass. One of several notes in unison is left. Where the accompaniment strikes a key that the
    melody holds, the melody goes on.
    """
    parts = _parts(score)
    if not parts:
        return []
    bars = np.array([bar.time for bar in score.bars])
    edges = _stretches(score)
    melody = _best_parts(_melody_likeness(parts, edges, bars))
    bass = _best_parts(_bass_likeness(parts, edges))
    return _merged(
        source
        for i, part in enumerate(parts)
        for source in _sources(part, edges, [m == i for m in melody], [b == i for b in bass])
    )


def _parts(score: Score) -> list[_InstrumentPart]:
    by_track: dict[int, list[Note]] = {}
    for note in score.notes:
        for number in note.tracks or (0,):
            by_track.setdefault(number, []).append(note)
    names = {track.number: (track.name, track.instrument) for track in score.tracks}
    return [
        _InstrumentPart(*names.get(number, ("", "")), tuple(notes))
        for number, notes in sorted(by_track.items())
    ]


def _stretches(score: Score) -> list[float]:
    """The times at which stretches of one bar or more begin, the first at the beginning [s]."""
    edges = [0.0]
    times = [bar.time for bar in score.bars]
    times = times or np.arange(0, score.total_time, _MIN_STRETCH).tolist()
    for time in times:
        if time >= edges[-1] + _MIN_STRETCH:
            edges.append(time)
    return edges


def _sources(
    part: _InstrumentPart,
    edges: Sequence[float],
    has_melody: Sequence[bool],
    has_bass: Sequence[bool],
) -> Iterator[SourceNote]:
    """Yield the notes of a part that has the melody, or the bass, in some stretches."""
    tops, bottoms = _outer(part.notes, 1), _outer(part.notes, -1)
    for i, n in enumerate(part.notes):
        stretch = bisect_right(edges, n.start + CHORD_TOLERANCE) - 1
        melody = has_melody[stretch] and i in tops
        bass = not melody and has_bass[stretch] and i in bottoms
        yield SourceNote(n.start, n.end, n.pitch, n.velocity, melody, bass, hands=n.hands)


def _merged(sources: Iterable[SourceNote]) -> list[SourceNote]:
    """The notes, one at a time on each key; see `sources_of`."""
    by_pitch: dict[int, list[SourceNote]] = {}
    for note in sorted(sources, key=lambda n: (n.start, not n.melody, not n.bass)):
        same_pitch = by_pitch.setdefault(note.pitch, [])
        if not same_pitch:
            same_pitch.append(note)
            continue
        previous = same_pitch[-1]
        end = max(previous.end, note.end)
        if note.start <= previous.start + TOGETHER:  # in unison
            melody, bass = previous.melody or note.melody, previous.bass or note.bass
            same_pitch[-1] = previous._replace(end=end, melody=melody, bass=bass and not melody)
        elif previous.melody and not note.melody and note.start <= previous.end:
            same_pitch[-1] = previous._replace(end=end)
        else:
            same_pitch[-1] = previous._replace(end=min(previous.end, note.start))
            same_pitch.append(note)
    return [note for notes in by_pitch.values() for note in notes]


def _outer(notes: Sequence[Note], sign: Literal[1, -1]) -> set[int]:
    """Indices of the notes above which none sounds, or below which none does for -1."""
    outer: set[int] = set()
    latest: Note | None = None
    for chord in chords(range(len(notes)), start=lambda i: notes[i].start):
        i = max(chord, key=lambda i: sign * notes[i].pitch)
        note = notes[i]
        held = latest is not None and latest.end > note.start + RELEASE_TIME
        if latest is None or not held or sign * note.pitch >= sign * latest.pitch:
            outer.add(i)
            latest = note
    return outer


def _melody_likeness(
    parts: Sequence[_InstrumentPart], edges: Sequence[float], bars: Array
) -> Array:
    """(P, S) how much each part is like a melody in each stretch."""
    loudness = float(np.mean([note.velocity for part in parts for note in part.notes]))
    active = _activity(parts, edges)
    lines = [Line.of(part.notes, bars) for part in parts]
    likeness = np.empty((len(parts), len(edges)))
    for i, (part, line) in enumerate(zip(parts, lines, strict=True)):
        always = likeness_by_name(part.name, part.instrument)
        always -= _FOLLOWS * any(line.follows(other) for other in lines if other is not line)
        for j, edge in enumerate(edges):
            near = line.between(edge - _CONTEXT, edge + _MIN_STRETCH + _CONTEXT)
            likeness[i, j] = always + near.likeness(loudness) if len(near.start) else 0.0
    return likeness * active - _ABSENT_MELODY * (1 - active)


def _bass_likeness(parts: Sequence[_InstrumentPart], edges: Sequence[float]) -> Array:
    """(P, S) how much each part is like a bass in each stretch."""
    low = [np.mean([min(n.pitch for n in chord) for chord in chords(p.notes)]) for p in parts]
    called = [bool(CALLED_BASS.search(f"{part.name} {part.instrument}".lower())) for part in parts]
    likeness = _CALLED * np.array(called) - (np.array(low) - _LOW) / _SEMITONES
    return likeness[:, None] - _ABSENT_BASS * (1 - _activity(parts, edges))


def _activity(parts: Sequence[_InstrumentPart], edges: Sequence[float]) -> Array:
    """(P, S) twice the share of each stretch in which each part sounds, at most 1."""
    last = max(note.end for part in parts for note in part.notes)
    bounds = np.array([*edges, max(last, edges[-1] + _MIN_STRETCH)])
    activity = np.zeros((len(parts), len(edges)))
    for row, part in zip(activity, parts, strict=True):
        for note in part.notes:
            first = max(bisect_right(edges, note.start + CHORD_TOLERANCE) - 1, 0)
            end = max(bisect_right(edges, note.end - CHORD_TOLERANCE), first + 1)
            inside = slice(first, end)
            begin, stop = bounds[first:end], bounds[first + 1 : end + 1]
            row[inside] += np.maximum(np.minimum(note.end, stop) - np.maximum(note.start, begin), 0)
    return np.minimum(2 * activity / np.diff(bounds), 1.0)


def _best_parts(likeness: Array) -> list[int]:
    """The best sequence of parts over the stretches (P, S), with a cost for each change."""
    change = _CHANGE * (1 - np.eye(len(likeness)))
    return cheapest_sequence(list(-likeness.T), [change] * (likeness.shape[1] - 1))
