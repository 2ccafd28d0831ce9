"""Broken chords."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from fractions import Fraction

from cadenza.music.signs.conventions import ARPEGGIO_STEP
from cadenza.music.signs.timed_note import Chord, TimedNote

_MOST_OF_CHORD = 0.5  # of the shortest note, within which the last one begins; a choice


def break_chords(notes: Iterable[TimedNote]) -> None:
    """Has notes with an arpeggio sign begin one after the other, the first of them on the beat.

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
        room = _MOST_OF_CHORD * min(note.end for note in chord) - _MOST_OF_CHORD * start
        each = min(ARPEGGIO_STEP, max(room, 0.0) / max(len(chord) - 1, 1))
        for place, note in enumerate(chord):
            note.start = start + place * each
