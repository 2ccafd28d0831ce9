"""Trills, mordents, turns and slides: the notes that a sign stands for."""

from __future__ import annotations

from itertools import pairwise

from cadenza.music.score import NATURALS, OCTAVE
from cadenza.music.signs.conventions import NOTES_A_SECOND
from cadenza.music.signs.signed_note import Ornament, OrnamentKind, SignedNote

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


def ornament_notes(note: SignedNote, start: float, end: float, led_to: bool) -> list[Played]:
    """The notes that a note with an ornament stands for, which fill its time without gaps.

    Mordents are those of Grove, turns those of Gehrkens.

    Args:
        note: the note.
        start: its beginning [s].
        end: its end [s].
        led_to: whether a grace note leads to it.
    """
    sign = note.ornament
    assert sign is not None
    if sign.kind is OrnamentKind.TRILL:
        return _trill(note, sign, start, end, led_to)
    upper, main, lower = _upper(note, sign), note.pitch, neighbour(note, -1, sign.below)
    other = upper
    if sign.kind is OrnamentKind.MORDENT:
        other = lower if sign.interval is None else main - sign.interval
    shakes = max((sign.notes - 1) // 2, 1) if sign.notes else 2 if sign.long else 1
    mordent = [main, *[other, main] * shakes, *_end(main, sign)]
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


def _upper(note: SignedNote, sign: Ornament) -> int:
    """The pitch of the upper neighbour."""
    return neighbour(note, 1, sign.above) if sign.interval is None else note.pitch + sign.interval


def _end(main: int, sign: Ornament) -> list[int]:
    """The two notes with which a trill or mordent ends, if the sign has them."""
    return [main - sign.turn, main] if sign.turn else []


def _trill(
    note: SignedNote, sign: Ornament, start: float, end: float, led_to: bool
) -> list[Played]:
    """Equally long notes that end on the main note, if the sign does not say how many there are.

    They begin on the upper neighbour (Bach), unless the sign says otherwise or a grace note leads
    to the note.
    """
    upper, main = _upper(note, sign), note.pitch
    begins = sign.begins
    if begins is None:
        begins = 0 if led_to else 1
    odd, last = begins == 0, _end(main, sign)
    if sign.notes:
        count = max(min(sign.notes, int((end - start) / _FASTEST) - len(last)), 2)
    else:
        fitting = int((end - start) * NOTES_A_SECOND + 1e-9) - len(last)
        count = max(fitting, _MIN_TRILL - odd)
        count -= (count - odd) % 2
    pitches = [main if k % 2 != odd else upper for k in range(count)]
    if begins == -1:
        pitches[0] = neighbour(note, -1, sign.below)
    pitches += last
    each = (end - start) / len(pitches)
    if each < _FASTEST:
        return [(start, end, main)]
    played = _sequence(pitches, start, each, end)
    return _accelerated(played, start, end) if sign.accelerates else played


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
