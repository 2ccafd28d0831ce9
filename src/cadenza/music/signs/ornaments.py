"""Trills, mordents, turns and slides: the notes that a sign stands for."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from cadenza.music.score import NATURALS, OCTAVE
from cadenza.music.signs.conventions import NOTES_A_SECOND
from cadenza.music.signs.notes import Ornament, OrnamentKind, SignedNote, SoundingNote

_SHARPS = (3, 0, 4, 1, 5, 2, 6)  # the steps that get sharps, in the order of keys: F, C, G, ...
_WHOLE_TONE = 2
_MIN_TRILL = 4  # notes: two shakes
_FASTEST = 0.05  # [s] a note has no ornament whose notes would be shorter; a choice
_FIRST = 4 / 3  # of the mean length has the first note of a trill that accelerates; a choice
_MAX_OF_NOTE = 0.5  # of the note, which a turn after it takes at most

Played = tuple[float, float, int]
"""A note of an ornament: start and end [s], and pitch."""


def neighbour(note: SignedNote, step: int, accidental: int | None = None) -> int:
    """The pitch a few steps of the staff above a note, or below it if `step` is negative.

    Args:
        note: the note.
        step: how many steps higher.
        accidental: the alteration [semitones] that a sign gives; None is that of the key.
    """
    natural = note.pitch - note.alter
    if natural % OCTAVE not in NATURALS:  # no line has this note: the file contradicts itself
        return note.pitch + step * _WHOLE_TONE
    octave, line = divmod(NATURALS.index(natural % OCTAVE) + step, len(NATURALS))
    natural += (octave * OCTAVE + NATURALS[line]) - natural % OCTAVE
    return natural + (alteration(line, note.fifths) if accidental is None else accidental)


def alteration(line: int, fifths: int) -> int:
    """How many semitones a key with so many sharps, or flats if negative, alters a step.

    The step 0 is C. Keys beyond seven sharps or flats have double ones.
    """
    place = _SHARPS.index(line)
    return (fifths - place + len(_SHARPS) - 1) // len(_SHARPS)


def ornament_notes(sounding: SoundingNote) -> list[Played]:
    """The notes that a note with an ornament stands for, which fill its time without gaps.

    Mordents are those of Grove, turns those of Gehrkens.
    """
    note, sign, start, end = sounding.of, sounding.of.ornament, sounding.start, sounding.end
    assert sign is not None
    main, lower = note.pitch, neighbour(note, -1, sign.below)
    upper = other = (
        neighbour(note, 1, sign.above) if sign.interval is None else main + sign.interval
    )
    last = [main - sign.turn, main] if sign.turn else []
    if sign.kind is OrnamentKind.TRILL:
        opening = int(not sounding.led_to) if sign.begins is None else sign.begins
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
    """The pitches of a trill of so many seconds, which end on the main note and the `last`.

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
    """Notes that last `each` [s], from `first` [s] on; the last lasts to the end.

    Where they would be too short to be played, there is only the last.
    """
    if each < _FASTEST:
        return [(first, end, pitches[-1])]
    times = [first + k * each for k in range(len(pitches))] + [end]
    return [(*pair, pitch) for pair, pitch in zip(pairwise(times), pitches, strict=True)]
