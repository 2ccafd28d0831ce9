"""Trills, mordents, turns and slides, the notes that they stand for, and grace notes."""

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import NATURALS, OCTAVE
from cadenza.music.signs import GRACE_LENGTH, NOTES_A_SECOND
from cadenza.music.signs.notes import (
    Chord,
    Grace,
    Ornament,
    OrnamentKind,
    SignedNote,
    SoundingNote,
    Voice,
    even_times,
)
from cadenza.music.signs.tempo_map import TempoMap

_SHARPS = (3, 0, 4, 1, 5, 2, 6)  # the steps that get sharps, in the order of keys: F, C, G, ...
_WHOLE_TONE = 2
_MIN_TRILL = 4  # notes: two shakes
_FASTEST = 0.05  # [s] a note has no ornament whose notes would be shorter; a choice
_FIRST = 4 / 3  # length of the first note of an accelerating trill, in mean lengths; a choice
_MAX_OF_NOTE = 0.5  # share of a note that a turn after it takes at most

Played = tuple[float, float, int]  # a note of an ornament: start and end [s], and pitch


def neighbour(note: SignedNote, step: int, accidental: int | None = None) -> int:
    """The pitch a few steps of the staff above a note, or below it if `step` is negative.

    It is altered by the `accidental` of a sign [semitones]; None is that of the key.
    """
    natural = note.pitch - note.alter
    if natural % OCTAVE not in NATURALS:  # no line has this note: the file contradicts itself
        return note.pitch + step * _WHOLE_TONE
    octave, line = divmod(NATURALS.index(natural % OCTAVE) + step, len(NATURALS))
    natural += (octave * OCTAVE + NATURALS[line]) - natural % OCTAVE
    return natural + (alteration(line, note.fifths) if accidental is None else accidental)


def alteration(line: int, fifths: int) -> int:
    """The semitones by which a key with some sharps, or flats if negative, alters a step.

    The step 0 is C. Keys beyond seven sharps or flats have double ones.
    """
    place = _SHARPS.index(line)
    return (fifths - place + len(_SHARPS) - 1) // len(_SHARPS)


def ornament_notes(sound: SoundingNote) -> list[Played]:
    """The notes that a note with an ornament stands for, which fill its time without gaps.

    Mordents are those of Grove, turns those of Gehrkens.
    """
    note, sign, start, end = sound.of, sound.of.ornament, sound.start, sound.end
    assert sign is not None
    main, lower = note.pitch, neighbour(note, -1, sign.below)
    upper = other = (
        neighbour(note, 1, sign.above) if sign.interval is None else main + sign.interval
    )
    last = [main - sign.turn, main] if sign.turn else []
    if sign.kind is OrnamentKind.TRILL:
        opening = int(not sound.led_to) if sign.begins is None else sign.begins
        pitches = _trill(sign, {1: upper, 0: main, -1: lower}, opening, end - start, last)
        each = (end - start) / len(pitches)
        if each < _FASTEST:
            return [(start, end, main)]
        played = _sequence(pitches, start, each, end)
        return _accelerated(played, start, end) if sign.accelerates else played
    other = upper
    if sign.kind is OrnamentKind.MORDENT:
        other = lower if sign.interval is None else main - sign.interval
    shakes = max((sign.notes - 1) // 2, 1) if sign.notes else 2 if sign.long else 1
    mordent = [main, *[other, main] * shakes, *last]
    pitches = {
        OrnamentKind.MORDENT: mordent,
        OrnamentKind.INVERTED_MORDENT: mordent,
        OrnamentKind.TURN: [upper, main, lower, main],
        OrnamentKind.INVERTED_TURN: [lower, main, upper, main],
        OrnamentKind.SLIDE: [neighbour(note, -2), neighbour(note, -1), main],
    }[sign.kind]
    opening = {1: upper, 0: main, -1: lower, None: pitches[0]}[sign.begins]
    if opening != pitches[0] and sign.kind is not OrnamentKind.SLIDE:
        pitches = [opening, *pitches]
    each = 1 / NOTES_A_SECOND
    if sign.delayed:
        each = min(each, _MAX_OF_NOTE * (end - start) / len(pitches))
        first = end - each * len(pitches)
        turned = _sequence(pitches, first, each, end)
        return [(start, first, main), *turned] if len(turned) > 1 else [(start, end, main)]
    return _sequence(pitches, start, min(each, (end - start) / len(pitches)), end)


def _trill(
    sign: Ornament, pitches: Mapping[int, int], opening: int, seconds: float, last: list[int]
) -> list[int]:
    """The pitches of a trill of some seconds, which end on the main note and the `last`.

    There are as many as the sign says, or as have time. They begin on the upper neighbour (Bach),
    unless the sign says otherwise or a grace note leads to the note: the `opening` is one of
    `pitches`, of the upper neighbour (1), the note itself (0) and the lower neighbour (-1).
    """
    is_odd = opening == 0
    if sign.notes:
        count = max(min(sign.notes, int(seconds / _FASTEST) - len(last)), 2)
    else:
        count = max(int(seconds * NOTES_A_SECOND + 1e-9) - len(last), _MIN_TRILL - is_odd)
        count -= (count - is_odd) % 2
    trill = [pitches[0] if k % 2 != is_odd else pitches[1] for k in range(1, count)]
    return [pitches[opening], *trill, *last]


def _accelerated(notes: list[Played], start: float, end: float) -> list[Played]:
    """The notes between two times [s], each shorter than the one before by as much."""

    def moved(time: float) -> float:
        share = (time - start) / (end - start)
        return min(start + (end - start) * share * (_FIRST - (_FIRST - 1) * share), end)

    return [(moved(begin), moved(stop), pitch) for begin, stop, pitch in notes]


def _sequence(pitches: list[int], first: float, each: float, end: float) -> list[Played]:
    """Notes of `each` [s] from `first` [s] to the end; only the last if that is too short."""
    if each < _FASTEST:
        return [(first, end, pitches[-1])]
    times = [first + k * each for k in range(len(pitches))] + [end]
    return [(*pair, pitch) for pair, pitch in zip(pairwise(times), pitches, strict=True)]


# Grace notes

_MAX_TAKEN = 0.5  # share of a neighbour that grace notes take at most; a choice
_MIN_SHARE = 0.01  # share of a neighbour, in whole per cents in files
_HALF, _TWO_THIRDS = Fraction(1, 2), Fraction(2, 3)
_THREE = 3  # halves of its value without the dot that a dotted note lasts


def place_graces(voice: Voice, tempo: TempoMap) -> None:
    """Give grace notes their times, and their neighbours those that are left to them.

    They are played one after the other before the beat, and the note before sounds on meanwhile;
    those after a trill end it. Where the file says that they take their time from one of their
    neighbours, they do. A single one without a stroke is an appoggiatura: it is played on the beat,
    as long as it shows (Grove), but takes at most half of the note, or two thirds of a dotted one
    (Gehrkens).
    """
    onsets = list(voice.chords)
    num_before = 0  # chords that begin earlier than the grace notes
    for onset, graces in voice.graces.items():
        while num_before < len(onsets) and onsets[num_before] < onset:
            num_before += 1
        previous = voice.chords[onsets[num_before - 1]] if num_before else None
        main = None if _grace(graces[0]).after else voice.chords.get(onset)
        for note in main or ():
            note.led_to = True
        if main is None or not _on_the_beat(graces, main, tempo):
            _before_the_beat(graces, previous, tempo.onsets if main else tempo.ends)


def _grace(chord: Chord) -> Grace:
    grace = chord[0].of.grace
    assert grace is not None
    return grace


def _on_the_beat(graces: Sequence[Chord], main: Chord, tempo: TempoMap) -> bool:
    """Play grace notes that take their time from the chord that they lead to, if they do."""
    grace = graces[0][0]
    if _grace(graces[0]).of_following:
        share = sum(_share(_grace(chord).of_following) for chord in graces)
        delayed, length = main, min(share, _MAX_TAKEN) * min(note.length for note in main)
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
        onset = min(note.start for note in previous)
        if grace.of_previous:
            length = sum(_share(_grace(chord).of_previous) for chord in graces) * (beat - onset)
            steals = True
        length = min(length, _MAX_TAKEN * (beat - onset))
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
