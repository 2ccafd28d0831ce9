"""When grace notes are played."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from cadenza.music.signs.conventions import GRACE_LENGTH, NOTES_A_SECOND
from cadenza.music.signs.notes import Chord, Grace, OrnamentKind, Voice, even_times
from cadenza.music.signs.tempo_map import TempoMap

_MAX_OF_NOTE = 0.5  # of the note before or after grace notes, which they take; a choice
_MIN_SHARE = 0.01  # of a neighbour, as files give per cents
_HALF, _TWO_THIRDS = Fraction(1, 2), Fraction(2, 3)
_THREE = 3  # a dotted note has so many halves of the next smaller value


def place_graces(voice: Voice, tempo: TempoMap) -> None:
    """Give grace notes their times, and their neighbours those that are left to them.

    They are played one after the other before the beat, and the note before sounds on meanwhile;
    those after a trill end it. Where the file says that they take their time from one of their
    neighbours, they do. A single one without a stroke is an appoggiatura: it is played on the beat,
    as long as it shows (Grove), but takes at most half of the note, or two thirds of a dotted one
    (Gehrkens).
    """
    onsets = list(voice.chords)
    before = 0  # chords that begin earlier than the grace notes
    for onset, graces in voice.graces.items():
        while before < len(onsets) and onsets[before] < onset:
            before += 1
        previous = voice.chords[onsets[before - 1]] if before else None
        main = None if _grace(graces[0]).after else voice.chords.get(onset)
        for note in main or ():
            note.led_to = True
        if main is None or not _on_the_beat(graces, main, tempo):
            _before_the_beat(graces, previous, tempo.onsets if main else tempo.ends)


def _grace(chord: Chord) -> Grace:
    """The sign of a chord of grace notes."""
    grace = chord[0].of.grace
    assert grace is not None
    return grace


def _on_the_beat(graces: Sequence[Chord], main: Chord, tempo: TempoMap) -> bool:
    """Play grace notes that take their time from the chord that they lead to, if they do."""
    grace = graces[0][0]
    if _grace(graces[0]).of_following:
        share = sum(_share(_grace(chord).of_following) for chord in graces)
        delayed, length = main, min(share, _MAX_OF_NOTE) * min(note.length for note in main)
    elif _is_appoggiatura(graces):
        delayed = [min(main, key=lambda note: abs(note.of.pitch - grace.of.pitch))]
        end = delayed[0].of.onset + min(grace.of.duration, _most(delayed[0].of.duration))
        length = min(float(tempo.onsets([end])[0]) - delayed[0].start, delayed[0].length)
    else:
        return False
    start = min(note.start for note in delayed)
    _in_turn(graces, start, start + length)
    for note in delayed:
        note.start = start + length
    return True


def _is_appoggiatura(graces: Sequence[Chord]) -> bool:
    sign = _grace(graces[0])
    is_single = len(graces) == len(graces[0]) == 1 and graces[0][0].of.duration > 0
    return is_single and not (sign.slash or sign.of_previous or sign.takes)


def _most(duration: Fraction) -> Fraction:
    """The most that an appoggiatura takes of a note: two thirds of a dotted one, half of others."""
    return duration * (_TWO_THIRDS if duration.numerator % _THREE == 0 else _HALF)


def _before_the_beat(
    graces: Sequence[Chord],
    previous: Chord | None,
    clock: Callable[[Sequence[Fraction]], NDArray[np.float64]],
) -> None:
    first = graces[0][0].of
    beat = float(clock([first.onset])[0])
    ends_trill = previous is not None and any(
        note.of.ornament is not None
        and note.of.ornament.kind is OrnamentKind.TRILL
        and note.of.end == first.onset
        for note in previous
    )
    each = 1 / NOTES_A_SECOND if ends_trill else GRACE_LENGTH
    length = each * len(graces)
    grace = _grace(graces[0])
    if grace.takes:
        length = beat - float(clock([first.onset - grace.takes * len(graces)])[0])
    steals = ends_trill
    if previous is not None:
        begun = min(note.start for note in previous)
        if grace.of_previous:
            length = sum(_share(_grace(chord).of_previous) for chord in graces) * (beat - begun)
            steals = True
        length = min(length, _MAX_OF_NOTE * (beat - begun))
    _in_turn(graces, beat - length, beat)
    if previous is not None and steals:
        for note in previous:
            note.end_by(beat - length)


def _in_turn(graces: Sequence[Chord], start: float, end: float) -> None:
    """Play chords one after the other, each as long as the others, between two times [s]."""
    for chord, (begin, stop) in zip(graces, even_times(start, end, len(graces)), strict=True):
        for note in chord:
            note.start, note.end = begin, stop


def _share(share: float | None) -> float:
    return min(max(share or 0.0, _MIN_SHARE), 1.0)
