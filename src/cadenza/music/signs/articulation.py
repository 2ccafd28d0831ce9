"""How long and how loud single notes are: articulation, slurs, accents, breaths."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import zip_longest

from cadenza.music.signs.conventions import (
    ACCENT,
    BREATH,
    MARCATO,
    PHRASE_LIFT,
    PORTATO,
    STACCATISSIMO,
    STACCATO,
    STRONG_ACCENT,
)
from cadenza.music.signs.notes import Chord, Mark, SignedNote, SoundingNote, Voice

_MAX_LIFTED = 0.5  # of a note, by which it ends earlier at most


def articulate(voice: Voice, slurred: set[Fraction]) -> None:
    """Give the chords of a voice their lengths and velocities.

    Notes last as long as they are written, if no sign says otherwise. Under a slur they last to
    the next note, even where that is late.

    Args:
        voice: the voice.
        slurred: the onsets of chords from which a slur leads on, see `slurred_onsets`.
    """
    in_slur, chords = False, list(voice.chords.values())
    for chord, following in zip_longest(chords, chords[1:]):
        was_in_slur, in_slur = in_slur, chord[0].of.onset in slurred
        for note in chord:
            share = _share(note.of.marks, in_slur or was_in_slur)
            if share < 1:
                note.end_by(note.start + share * note.length)
            elif in_slur:
                _join(note, following)
            elif was_in_slur:
                _lift(note, PHRASE_LIFT)
            if Mark.BREATH in note.of.marks:
                _lift(note, BREATH)
            note.velocity *= _loudness(note.of.marks)


def slurred_onsets(notes: Iterable[SignedNote]) -> dict[tuple[int, str], set[Fraction]]:
    """Voices, by part and name -> the onsets of chords from which a slur leads to the next.

    A slur goes through the voice in which it begins. One that does not end, or ends before it
    begins, has no meaning.
    """
    onsets: dict[tuple[int, str], set[Fraction]] = {}
    ends: list[tuple[Fraction, bool, int, tuple[int, str]]] = []
    for note in notes:
        voice = note.part, note.voice
        if note.grace is None:
            onsets.setdefault(voice, set()).add(note.onset)
        ends += ((note.onset, end.begins, end.number, voice) for end in note.slurs)
    spans: dict[tuple[int, str], list[tuple[Fraction, Fraction]]] = {}
    begun: dict[tuple[int, int], tuple[Fraction, tuple[int, str]]] = {}
    for onset, begins, number, voice in sorted(ends):  # at one place, ends first
        if begins:
            begun[voice[0], number] = onset, voice
        elif (start := begun.pop((voice[0], number), None)) is not None:
            spans.setdefault(start[1], []).append((start[0], onset))
    return {
        voice: _within(sorted(onsets[voice]), spans[voice]) for voice in spans if voice in onsets
    }


def _within(onsets: list[Fraction], spans: list[tuple[Fraction, Fraction]]) -> set[Fraction]:
    """The `onsets`, sorted, that lie in any of the spans, which do not contain their ends."""
    within: set[Fraction] = set()
    spans.sort()
    reach, span = Fraction(0), 0
    for onset in onsets:
        while span < len(spans) and spans[span][0] <= onset:
            reach = max(reach, spans[span][1])
            span += 1
        if span and onset < reach:
            within.add(onset)
    return within


def _share(marks: frozenset[Mark], slurred: bool) -> float:
    """The length of a note with these marks, as a share of the written one."""
    if Mark.STACCATISSIMO in marks:
        return STACCATISSIMO
    if Mark.PORTATO in marks:
        return PORTATO
    if Mark.STACCATO in marks:
        return PORTATO if slurred or Mark.TENUTO in marks else STACCATO
    if Mark.STRONG_ACCENT in marks and not slurred and Mark.TENUTO not in marks:
        return MARCATO
    return 1.0


def _loudness(marks: frozenset[Mark]) -> float:
    """The velocity of a note with these marks, as a multiple of that of others."""
    if Mark.STRONG_ACCENT in marks:
        return STRONG_ACCENT
    return ACCENT if Mark.ACCENT in marks else 1.0


def _join(note: SoundingNote, following: Chord | None) -> None:
    """Have a note last until the next chord of its voice begins, if it is written so."""
    if following and following[0].of.onset == note.of.end and not note.cut:
        note.end = max(note.end, min(each.start for each in following))


def _lift(note: SoundingNote, seconds: float) -> None:
    """End a note earlier by a time [s], or half of it."""
    note.end_by(note.end - min(seconds, _MAX_LIFTED * note.length))
