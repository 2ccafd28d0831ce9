"""Tremolos on one note or chord, and between two."""

from __future__ import annotations

from fractions import Fraction

from cadenza.music.signs.conventions import NOTES_A_SECOND
from cadenza.music.signs.signed_note import Role
from cadenza.music.signs.timed_note import Chord, Times, Voice, even_times

_UNMEASURED = 3  # marks in place of those that a tremolo without measure lacks
_MOST_MARKS = 8  # as in MusicXML


def tremolo_times(voice: Voice) -> dict[int, Times]:
    """Notes of a voice with a tremolo, by `id` -> the times [s] from and up to which they sound.

    A tremolo is measured: each of its marks halves the value of its notes, from eighths on. Where
    they would follow each other faster than `NOTES_A_SECOND`, they are as fast as that.
    """
    found: dict[int, Times] = {}
    first: Chord | None = None
    for chord in voice.chords.values():
        role = chord[0].of.tremolo.role if chord[0].of.tremolo else None
        if role is Role.ALONE:
            for note in chord:
                assert note.of.tremolo is not None  # as the whole chord has it
                count = _count(note.of.duration, note.of.tremolo.marks)
                found[id(note)] = _even(note.start, note.end, count)
        elif role is Role.SECOND and first is not None:
            found |= _alternating(first, chord)
        first = chord if role is Role.FIRST else None
    return found


def _alternating(first: Chord, second: Chord) -> dict[int, Times]:
    sign = first[0].of.tremolo
    assert sign is not None
    start, end = min(note.start for note in first), max(note.end for note in second)
    count = _count(first[0].of.duration + second[0].of.duration, sign.marks)
    times = _even(start, end, max(count, 2), times=2)
    both = ((first, times[::2]), (second, times[1::2]))
    return {id(note): turns for chord, turns in both for note in chord}


def _count(duration: Fraction, marks: int) -> int:
    """How many notes a tremolo has that lasts so many quarters."""
    if duration <= 0:
        return 1
    shown = duration * _as_shown(duration)
    strokes = 2 ** min(marks or _UNMEASURED, _MOST_MARKS)
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
