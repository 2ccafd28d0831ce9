"""Signs of chords, which files have at one of the notes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

from cadenza.music.signs.signed_note import SignedNote


def with_signs_of_chords(notes: Sequence[SignedNote]) -> list[SignedNote]:
    """The notes, in their order, each with the signs that its chord has.

    Articulations and tremolos are for all notes of a chord in one voice, and so is the sign of an
    arpeggio. An ornament that one of them has is for the highest, as it stands above the chord.
    """
    chords = defaultdict[tuple[int, str, Fraction], list[int]](list)
    for index, note in enumerate(notes):
        if note.grace is None:
            chords[note.part, note.voice, note.onset].append(index)
    found = list(notes)
    for chord in chords.values():
        if len(chord) > 1:
            for index, note in zip(chord, _shared([notes[i] for i in chord]), strict=True):
                found[index] = note
    return found


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
