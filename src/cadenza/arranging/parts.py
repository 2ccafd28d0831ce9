"""The parts of a song, and which of their notes are melody and bass.

From part to part the melody may move, and so may the bass: each part has a likeness to a melody,
and to a bass, in each stretch of the song. The best sequence of parts over the stretches is found
by a dynamic programme (Viterbi) that pays for every change.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.arranging.likeness import CALLED_BASS, Line, likeness_by_name
from cadenza.music.score import CHORD_TOLERANCE, RELEASE_TIME, Note, Score, chords
from cadenza.music.viterbi import cheapest_sequence

Array = NDArray[np.float64]

_STRETCH = 2.0  # [s] the least length over which one part has the melody, or the bass
_AROUND = 4.0  # [s] before and after a stretch that are looked at with it
_CHANGE = 4.0  # cost of melody or bass going to another part
_ABSENT_MELODY, _ABSENT_BASS = 3.0, 6.0  # cost of a part that has it and does not play
_FOLLOWS = 3.0  # how much less a second voice is like a melody
_CALLED, _LOW, _SEMITONES = 3.0, 40.0, 6.0  # a bass is called so; so much lower is worth 1


class Role(Enum):
    """What a note is for."""

    MELODY = "melody"
    BASS = "bass"
    HARMONY = "harmony"


@dataclass(frozen=True)
class Part:
    """The notes of one instrument, and what each of them is for."""

    name: str
    instrument: str
    notes: tuple[Note, ...]
    roles: tuple[Role, ...] = ()

    @property
    def names(self) -> str:
        """The name and the instrument in small letters."""
        return f"{self.name} {self.instrument}".lower()


def parts_of(score: Score) -> list[Part]:
    """The parts of a song that are played, with a role for every note.

    A score without tracks is one part, of which the highest notes are the melody and the lowest
    the bass.
    """
    parts = _tracks(score)
    if not parts:
        return []
    bars = np.array([bar.time for bar in score.bars])
    edges = _stretches(score)
    melody = _best_parts(_melody_likeness(parts, edges, bars))
    bass = _best_parts(_bass_likeness(parts, edges))
    has_melody = [[each == i for each in melody] for i in range(len(parts))]
    has_bass = [[each == i for each in bass] for i in range(len(parts))]
    return [
        Part(part.name, part.instrument, part.notes, _roles(part.notes, edges, *has))
        for part, *has in zip(parts, has_melody, has_bass, strict=True)
    ]


def _tracks(score: Score) -> list[Part]:
    """The parts of a score by the tracks of its notes."""
    by_track: dict[int, list[Note]] = {}
    for note in score.notes:
        for number in note.tracks or (0,):
            by_track.setdefault(number, []).append(note)
    names = {track.number: (track.name, track.instrument) for track in score.tracks}
    return [
        Part(*names.get(number, ("", "")), tuple(notes))
        for number, notes in sorted(by_track.items())
    ]


def _stretches(score: Score) -> list[float]:
    """The times at which stretches of one bar or more begin, the first at the beginning [s]."""
    edges = [0.0]
    times = [bar.time for bar in score.bars] or np.arange(0, score.total_time, _STRETCH).tolist()
    for time in times:
        if time >= edges[-1] + _STRETCH:
            edges.append(time)
    return edges


def _roles(
    notes: Sequence[Note],
    edges: Sequence[float],
    has_melody: Sequence[bool],
    has_bass: Sequence[bool],
) -> tuple[Role, ...]:
    """What each note of a part is for that has the melody, or the bass, in some stretches."""
    tops, bottoms, roles = _outer(notes, 1), _outer(notes, -1), []
    for i, note in enumerate(notes):
        stretch = bisect_right(edges, note.start + CHORD_TOLERANCE) - 1
        if has_melody[stretch] and i in tops:
            roles.append(Role.MELODY)
        elif has_bass[stretch] and i in bottoms:
            roles.append(Role.BASS)
        else:
            roles.append(Role.HARMONY)
    return tuple(roles)


def _outer(notes: Sequence[Note], sign: Literal[1, -1]) -> set[int]:
    """Indices of the notes above which none sounds, or below which none does for -1."""
    index = {id(note): i for i, note in enumerate(notes)}
    found: set[int] = set()
    latest: Note | None = None
    for chord in chords(notes):
        note = max(chord, key=lambda each: sign * each.pitch)
        held = latest is not None and latest.end > note.start + RELEASE_TIME
        if latest is None or not held or sign * note.pitch >= sign * latest.pitch:
            found.add(index[id(note)])
            latest = note
    return found


def _melody_likeness(parts: Sequence[Part], edges: Sequence[float], bars: Array) -> Array:
    """(P, S) how much each part is like a melody in each stretch."""
    loudness = float(np.mean([note.velocity for part in parts for note in part.notes]))
    active = _activity(parts, edges)
    lines = [Line.of(part.notes, bars) for part in parts]
    likeness = np.empty((len(parts), len(edges)))
    for i, (part, line) in enumerate(zip(parts, lines, strict=True)):
        always = likeness_by_name(part.name, part.instrument)
        always -= _FOLLOWS * any(line.follows(other) for other in lines if other is not line)
        for j, edge in enumerate(edges):
            near = line.between(edge - _AROUND, edge + _STRETCH + _AROUND)
            likeness[i, j] = always + near.likeness(loudness) if len(near.start) else 0.0
    return likeness * active - _ABSENT_MELODY * (1 - active)


def _bass_likeness(parts: Sequence[Part], edges: Sequence[float]) -> Array:
    """(P, S) how much each part is like a bass in each stretch."""
    low = [np.mean([min(n.pitch for n in chord) for chord in chords(p.notes)]) for p in parts]
    called = [bool(CALLED_BASS.search(part.names)) for part in parts]
    likeness = _CALLED * np.array(called) - (np.array(low) - _LOW) / _SEMITONES
    return likeness[:, None] - _ABSENT_BASS * (1 - _activity(parts, edges))


def _activity(parts: Sequence[Part], edges: Sequence[float]) -> Array:
    """(P, S) twice the share of each stretch in which each part sounds, at most 1."""
    last = max(note.end for part in parts for note in part.notes)
    bounds = np.array([*edges, max(last, edges[-1] + _STRETCH)])
    sounding = np.zeros((len(parts), len(edges)))
    for row, part in zip(sounding, parts, strict=True):
        for note in part.notes:
            first = max(bisect_right(edges, note.start + CHORD_TOLERANCE) - 1, 0)
            end = max(bisect_right(edges, note.end - CHORD_TOLERANCE), first + 1)
            inside = slice(first, end)
            begin, stop = bounds[first:end], bounds[first + 1 : end + 1]
            row[inside] += np.maximum(np.minimum(note.end, stop) - np.maximum(note.start, begin), 0)
    return np.minimum(2 * sounding / np.diff(bounds), 1.0)


def _best_parts(likeness: Array) -> list[int]:
    """The best sequence of parts over the stretches (P, S), with a cost for each change."""
    change = _CHANGE * (1 - np.eye(len(likeness)))
    return cheapest_sequence(list(-likeness.T), [change] * (likeness.shape[1] - 1))
