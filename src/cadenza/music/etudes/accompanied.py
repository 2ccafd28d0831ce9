"""Etudes for the hand that accompanies: Alberti basses and leaps. And trills, accompanied."""

from __future__ import annotations

from collections.abc import Iterator

from cadenza.music.etudes.harmony import Chord
from cadenza.music.etudes.keys import OCTAVE, STEPS
from cadenza.music.etudes.melody import melody
from cadenza.music.etudes.sheet import Sheet, Tone
from cadenza.music.score import LOWEST_PITCH

_ALBERTI = (0, 2, 1, 2)
_SOFT = 60
_LOUD = 84


def alberti(sheet: Sheet) -> Iterator[Tone]:
    """A melody over chords that the left hand breaks: lowest, highest, middle, highest."""
    *chords, _ = sheet.chords()
    for at, length, degree, chord in melody(sheet, chords, 2, STEPS + 4):
        yield Tone(at, length, sheet.pitch(degree, chord), _LOUD)
    for bar, chord in enumerate(chords):
        lowest = chord.nearest(-STEPS - 2)
        for i in range(sheet.bar):
            degree = chord.tone(lowest + _ALBERTI[i % len(_ALBERTI)])
            yield Tone(bar * sheet.bar + i, 1, sheet.pitch(degree, chord), _SOFT)
    yield from sheet.ending(right=STEPS)


def leaps(sheet: Sheet) -> Iterator[Tone]:
    """The left hand leaps from basses to chords; in harder etudes the right one leaps as well."""
    *chords, _ = sheet.chords()
    widest = 2 * (2 + sheet.difficulty)  # [semitones]
    for bar, chord in enumerate(chords):
        yield from _stride(sheet, bar, chord, widest)
    for at, length, degree, chord in melody(sheet, chords, 3, STEPS + 3, slow=True):
        if sheet.difficulty < 6 or length == 1:
            yield Tone(at, length, sheet.pitch(degree, chord), _LOUD)
        else:
            yield from _leap_up(sheet, at, length, degree, chord, widest)
    yield from sheet.ending(right=STEPS)


def _stride(sheet: Sheet, bar: int, chord: Chord, widest: int) -> Iterator[Tone]:
    """Bass and chord in turn, as in a march; in three beats bass, chord, chord."""
    above = [chord.tone(chord.nearest(-STEPS + 1) + i) for i in range(sheet.thickness)]
    pitches = [sheet.pitch(degree, chord) for degree in above]
    bass = sheet.pitch(chord.root - STEPS, chord)
    while bass >= pitches[0]:
        bass -= OCTAVE
    while bass - OCTAVE >= max(pitches[0] - widest, LOWEST_PITCH):
        bass -= OCTAVE
    begin = bar * sheet.bar
    for beat in range(sheet.beats):
        at = begin + beat * sheet.division
        if beat % (2 if sheet.beats % 2 == 0 else sheet.beats) == 0:
            yield Tone(at, sheet.division, bass, _LOUD)
        else:
            for pitch in pitches:
                yield Tone(at, sheet.division, pitch, _SOFT)


def _leap_up(
    sheet: Sheet, at: float, length: float, degree: int, chord: Chord, widest: int
) -> Iterator[Tone]:
    """A note, and then a tone of the chord as far above it as is allowed."""
    low = sheet.pitch(degree, chord)
    index = chord.nearest(degree)
    while sheet.pitch(chord.tone(index + 1), chord) - low <= widest:
        index += 1
    yield Tone(at, length / 2, low, _LOUD)
    yield Tone(at + length / 2, length / 2, sheet.pitch(chord.tone(index), chord), _LOUD)


def trills(sheet: Sheet) -> Iterator[Tone]:
    """A trill with a turn in each bar, by one hand over chords of the other, later by both."""
    *chords, _ = sheet.chords()
    for bar, chord in enumerate(chords):
        hands = sheet.hands(bar)
        right, left = (chord.tone(chord.nearest(home)) for home in (4, 1 - STEPS))
        if "right" in hands:
            yield from _trill(sheet, bar, chord, right)
        if "left" in hands:
            yield from _trill(sheet, bar, chord, left)
        if hands == ("right",):
            yield from _support(sheet, bar, chord, -STEPS - 3)
        elif hands == ("left",):
            yield from _support(sheet, bar, chord, 3)
    yield from sheet.ending()


def _trill(sheet: Sheet, bar: int, chord: Chord, main: int) -> Iterator[Tone]:
    """Main note and upper neighbour in turn; before the end the lower neighbour."""
    at = bar * sheet.bar
    for i in range(sheet.bar - 2):
        yield Tone(at + i, 1, sheet.pitch(main + i % 2, chord))
    yield Tone(at + sheet.bar - 2, 1, sheet.pitch(main - 1, chord))
    yield Tone(at + sheet.bar - 1, 1, sheet.pitch(main, chord))


def _support(sheet: Sheet, bar: int, chord: Chord, home: int) -> Iterator[Tone]:
    for i in range(sheet.thickness):
        pitch = sheet.pitch(chord.tone(chord.nearest(home) + i), chord)
        yield Tone(bar * sheet.bar, sheet.bar, pitch, _SOFT)
