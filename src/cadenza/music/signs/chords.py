"""Signs of chords: what all of their notes have, broken chords and tremolos."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import replace
from fractions import Fraction

from cadenza.music.signs.conventions import ARPEGGIO_STEP, NOTES_A_SECOND
from cadenza.music.signs.notes import (
    Chord,
    Role,
    SignedNote,
    SoundingNote,
    Times,
    Voice,
    even_times,
)


def with_signs_of_chords(notes: Sequence[SignedNote]) -> list[SignedNote]:
    """The notes, in their order, each with the signs that its chord has.

    Articulations and tremolos are for all notes of a chord in one voice, and so is the sign of an
    arpeggio. An ornament that one of them has is for the highest, as it stands above the chord.
    """
    chords = defaultdict[tuple[int, str, Fraction], list[int]](list)
    for index, note in enumerate(notes):
        if note.grace is None:
            chords[note.part, note.voice, note.onset].append(index)
    signed = list(notes)
    for chord in chords.values():
        if len(chord) > 1:
            for index, note in zip(chord, _shared([notes[i] for i in chord]), strict=True):
                signed[index] = note
    return signed


def _shared(chord: Sequence[SignedNote]) -> list[SignedNote]:
    marks = frozenset(mark for note in chord for mark in note.marks)
    tremolo = next((note.tremolo for note in chord if note.tremolo), None)
    arpeggio = next((note.arpeggio for note in chord if note.arpeggio), None)
    shared = [
        replace(
            note, marks=marks, tremolo=note.tremolo or tremolo, arpeggio=note.arpeggio or arpeggio
        )
        for note in chord
    ]
    ornaments = [note.ornament for note in chord if note.ornament]
    if len(ornaments) == 1:
        shared = [replace(note, ornament=None) for note in shared]
        top = max(range(len(chord)), key=lambda index: chord[index].pitch)
        shared[top] = replace(shared[top], ornament=ornaments[0])
    return shared


_MAX_OF_CHORD = 0.5  # of the shortest note, within which the last one begins; a choice


def break_chords(notes: Iterable[SoundingNote]) -> None:
    """Have notes with an arpeggio sign begin one after the other, the first of them on the beat.

    All last as long as they are written (Gehrkens); that the first is on the beat is a choice.
    """
    groups = defaultdict[tuple[Fraction, int, int | None, int], Chord](list)
    for note in notes:
        sign = note.of.arpeggio
        if sign is not None and sign.step and note.of.grace is None:
            staff = note.of.staff if sign.number is None else 0
            groups[note.of.onset, note.of.part, sign.number, staff].append(note)
    for chord in groups.values():
        step = chord[0].of.arpeggio.step if chord[0].of.arpeggio else 1
        chord.sort(key=lambda note: step * note.of.pitch)
        start = max(note.start for note in chord)
        room = _MAX_OF_CHORD * min(note.end for note in chord) - _MAX_OF_CHORD * start
        each = min(ARPEGGIO_STEP, max(room, 0.0) / max(len(chord) - 1, 1))
        for place, note in enumerate(chord):
            note.start = start + place * each


_UNMEASURED = 3  # marks in place of those that a tremolo without measure lacks
_MAX_MARKS = 8  # as in MusicXML


def play_tremolos(voice: Voice) -> None:
    """Give the notes of a voice with a tremolo their turns.

    A tremolo is measured: each of its marks halves the value of its notes, from eighths on. Where
    they would follow each other faster than `NOTES_A_SECOND`, they are as fast as that.
    """
    first: Chord | None = None
    for chord in voice.chords.values():
        sign = chord[0].of.tremolo
        role = sign.role if sign else None
        for note in chord if role is Role.ALONE else ():
            assert note.of.tremolo is not None  # as the whole chord has it
            count = _count(note.of.duration, note.of.tremolo.marks)
            note.turns = _even(note.start, note.end, count)
        if role is Role.SECOND and first is not None:
            _alternate(first, chord)
        first = chord if role is Role.FIRST else None


def _alternate(first: Chord, second: Chord) -> None:
    """Have two chords take turns."""
    sign = first[0].of.tremolo
    assert sign is not None
    start, end = min(note.start for note in first), max(note.end for note in second)
    count = _count(first[0].of.duration + second[0].of.duration, sign.marks)
    times = _even(start, end, max(count, 2), times=2)
    for chord, turns in ((first, times[::2]), (second, times[1::2])):
        for note in chord:
            note.turns = turns


def _count(duration: Fraction, marks: int) -> int:
    """How many notes a tremolo has that lasts so many quarters."""
    if duration <= 0:
        return 1
    shown = duration * _as_shown(duration)
    strokes = 2 ** min(marks or _UNMEASURED, _MAX_MARKS)
    return max(1, round(shown * strokes if shown >= 1 else strokes * (shown * _undotted(shown))))


def _as_shown(duration: Fraction) -> Fraction:
    """What a length in a tuplet is multiplied by to be the one that its notes show: 3/2 of 3."""
    odd = duration.denominator
    while odd % 2 == 0:
        odd //= 2
    return Fraction(odd, 1 << (odd.bit_length() - 1))


def _undotted(shown: Fraction) -> int:
    """How many of the value of a flagged note, without its dots, are in a quarter."""
    parts = 1
    while Fraction(1, parts) > shown:
        parts *= 2
    return parts


def _even(start: float, end: float, count: int, times: int = 1) -> Times:
    """So many even notes between two times [s], fewer if too fast; a multiple of `times`."""
    most = max(int((end - start) * NOTES_A_SECOND + 1e-9), 1)
    return even_times(start, end, max(min(count, most) // times, 1) * times)
