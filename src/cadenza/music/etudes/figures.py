"""Etudes of figures on a chord a bar: arpeggios, broken chords, repeated notes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cadenza.fingers import Side
from cadenza.music.etudes.harmony import Chord
from cadenza.music.etudes.keys import STEPS
from cadenza.music.etudes.melody import melody
from cadenza.music.etudes.sheet import Sheet, Tone

_HOME: dict[Side, int] = {"right": 0, "left": -STEPS}
# Tones of a chord and its octave, in the order in which they are played.
_CELLS = ((0, 1, 2, 3), (0, 2, 1, 3), (3, 1, 2, 0), (0, 2, 1, 2), (0, 3, 1, 3), (3, 2, 1, 2))
_CHORD = 64  # velocity of chords that accompany


def arpeggios(sheet: Sheet) -> Iterator[Tone]:
    """Up the chord in the first half of each bar, and down in the second."""
    half = sheet.bar // 2
    wave = [half - abs(half - i) for i in range(sheet.bar)]
    yield from _figures(sheet, wave, wave)


def broken_chords(sheet: Sheet) -> Iterator[Tone]:
    """Cells of four notes over a chord and its inversions, upwards and downwards in turn."""
    cell = _CELLS[sheet.pick(*range(len(_CELLS)))]
    cells = range(sheet.bar // len(cell))
    rising = [inversion + tone for inversion in cells for tone in cell]
    falling = [inversion + tone for inversion in reversed(cells) for tone in cell]
    yield from _figures(sheet, rising, falling)


def _figures(sheet: Sheet, odd: Sequence[int], even: Sequence[int]) -> Iterator[Tone]:
    """Figures of odd and of even bars, as tones of a chord; the hand without one holds a chord."""
    *chords, _ = sheet.chords()
    for bar, chord in enumerate(chords):
        figure = even if bar % 2 else odd
        hands = sheet.hands(bar)
        for hand in hands:
            lowest = chord.nearest(_HOME[hand])
            for i, tone in enumerate(figure):
                pitch = sheet.pitch(chord.tone(lowest + tone), chord)
                yield Tone(bar * sheet.bar + i, 1, pitch)
        if hands == ("right",):
            yield from _held(sheet, bar, chord, chord.nearest(2 - 2 * STEPS))
        elif hands == ("left",):
            highest = chord.nearest(_HOME["left"]) + max(figure)
            yield from _held(sheet, bar, chord, max(highest + 2, chord.nearest(STEPS + 2)))
    yield from sheet.ending()


def _held(sheet: Sheet, bar: int, chord: Chord, lowest: int) -> Iterator[Tone]:
    """A chord from its tone `lowest` upwards; in the easiest etudes nothing."""
    count = 0 if sheet.difficulty <= 2 else 1 if sheet.difficulty == 3 else 3
    for tone in range(lowest, lowest + count):
        yield Tone(bar * sheet.bar, sheet.bar, sheet.pitch(chord.tone(tone), chord), _CHORD)


def repeated_notes(sheet: Sheet) -> Iterator[Tone]:
    """A melody of which every note is struck again and again, over chords or, later, basses."""
    *chords, _ = sheet.chords()
    doubled = sheet.difficulty >= 9
    for at, length, degree, chord in melody(sheet, chords, 0, STEPS + 2, slow=True):
        for i in range(int(length)):
            degrees = (degree, degree - 2) if doubled else (degree,)
            for each in degrees:
                yield Tone(at + i, 0.6, sheet.pitch(each, chord))
    for bar, chord in enumerate(chords):
        yield from _basses(sheet, bar, chord)
    yield from sheet.ending()


def _basses(sheet: Sheet, bar: int, chord: Chord) -> Iterator[Tone]:
    """Of a bar with repeated notes: one at first, then a chord a beat, then repeated as well."""
    easy, hard = sheet.difficulty <= 2, sheet.difficulty >= 8
    every = sheet.bar if easy else 1 if hard else sheet.division
    count = 1 if sheet.difficulty < 4 or every == 1 else 2
    lowest = chord.nearest(-STEPS - 3)
    for at in range(0, sheet.bar, every):
        for i in range(count):
            pitch = sheet.pitch(chord.tone(lowest + 2 * i), chord)
            yield Tone(bar * sheet.bar + at, 0.6 * every, pitch, _CHORD)
