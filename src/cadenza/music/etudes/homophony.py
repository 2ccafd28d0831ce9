"""Homophonic etudes, with a chord for each bar.

They are Alberti basses, leaps, trills, arpeggios, broken chords and repeated notes.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from cadenza.fingers import Side
from cadenza.music.etudes.harmony import FORBIDDEN, STEPS, Triad, random_costs
from cadenza.music.etudes.sheet import PHRASE, EtudeSheet, Tone, pick
from cadenza.music.score import LOWEST_PITCH, OCTAVE
from cadenza.music.viterbi import cheapest_sequence

# MIDI velocities of accompaniments, of held or struck chords, and of melodies.
_SOFT, _CHORD, _LOUD = 60, 64, 84
_STACCATO = 0.6  # sounding share of a repeated note, after which the key comes up
# Difficulties from which the right hand leaps and repeated notes are thirds.
_RIGHT_LEAPS, _REPEATED_THIRDS = 6, 9

_HOME: dict[Side, int] = {"right": 0, "left": -STEPS}
"""The degree around which each hand has its figures."""
_ALBERTI = (0, 2, 1, 2)  # tones of a triad: lowest, highest, middle, highest
_CELLS = ((0, 1, 2, 3), (0, 2, 1, 3), (3, 1, 2, 0), (0, 2, 1, 2), (0, 3, 1, 3), (3, 2, 1, 2))
"""Tones of a triad and its octave in the orders of broken chords."""

# Melodies
_RHYTHMS: dict[int, tuple[tuple[float, ...], ...]] = {
    3: ((3,), (2, 1), (1, 1, 1), (1.5, 0.5, 1), (1, 0.5, 0.5, 1)),
    4: (
        (4,),
        (2, 2),
        (2, 1, 1),
        (1, 1, 2),
        (1, 1, 1, 1),
        (1.5, 0.5, 1, 1),
        (1, 0.5, 0.5, 2),
        (0.5, 0.5, 1, 0.5, 0.5, 1),
    ),
}
"""Beats of a bar -> its rhythms in beats, from the calm to the lively."""
_INTERVAL_COSTS = np.array([60, 0, 20, 50, 90, 140, 180, 200])  # by degrees: seconds are cheapest
_RANDOM = 100  # largest random cost of a note


def alberti(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield a melody over an Alberti bass."""
    *chords, _ = sheet.chords()
    for at, length, degree, chord in _melody(sheet, chords, 2, STEPS + 4):
        yield Tone(at, length, sheet.pitch(degree, chord), _LOUD)
    for bar, chord in enumerate(chords):
        lowest = chord.nearest(-STEPS - 2)
        for i in range(sheet.bar):
            degree = chord.tone(lowest + _ALBERTI[i % len(_ALBERTI)])
            yield Tone(bar * sheet.bar + i, 1, sheet.pitch(degree, chord), _SOFT)
    yield from sheet.ending(right=STEPS)


def leaps(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield leaps of the left hand from bass to chord, in harder etudes of the right one, too."""
    *chords, _ = sheet.chords()
    widest = 2 * (2 + sheet.difficulty)  # [semitones]
    for bar, chord in enumerate(chords):
        yield from _stride(sheet, bar, chord, widest)
    for at, length, degree, chord in _melody(sheet, chords, 3, STEPS + 3, slow=True):
        if sheet.difficulty < _RIGHT_LEAPS or length == 1:
            yield Tone(at, length, sheet.pitch(degree, chord), _LOUD)
        else:
            yield from _leap_up(sheet, at, length, degree, chord, widest)
    yield from sheet.ending(right=STEPS)


def _stride(sheet: EtudeSheet, bar: int, chord: Triad, widest: int) -> Iterator[Tone]:
    """Yield bass and chord in turn, as in a march; in triple metre bass, chord, chord."""
    pitches = sheet.voicing(chord, chord.nearest(-STEPS + 1), sheet.thickness)
    bass = sheet.pitch(chord.root - STEPS, chord)
    while bass >= pitches[0]:
        bass -= OCTAVE
    while bass - OCTAVE >= max(pitches[0] - widest, LOWEST_PITCH):
        bass -= OCTAVE
    bass_every = 2 if sheet.beats % 2 == 0 else sheet.beats
    for beat in range(sheet.beats):
        at = bar * sheet.bar + beat * sheet.division
        if beat % bass_every == 0:
            yield Tone(at, sheet.division, bass, _LOUD)
        else:
            yield from (Tone(at, sheet.division, pitch, _SOFT) for pitch in pitches)


def _leap_up(
    sheet: EtudeSheet, at: float, length: float, degree: int, chord: Triad, widest: int
) -> Iterator[Tone]:
    """Yield a note, and then the highest tone of the chord at most `widest` semitones above it."""
    low = sheet.pitch(degree, chord)
    index = chord.nearest(degree)
    while sheet.pitch(chord.tone(index + 1), chord) - low <= widest:
        index += 1
    yield Tone(at, length / 2, low, _LOUD)
    yield Tone(at + length / 2, length / 2, sheet.pitch(chord.tone(index), chord), _LOUD)


def trills(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield a trill with a turn in each bar, of one hand over chords, in harder etudes of both."""
    *chords, _ = sheet.chords()
    for bar, chord in enumerate(chords):
        hands = sheet.hands(bar)
        right, left = (chord.tone(chord.nearest(home)) for home in (4, 1 - STEPS))
        if "right" in hands:
            yield from _trill(sheet, bar, chord, right)
        if "left" in hands:
            yield from _trill(sheet, bar, chord, left)
        if len(hands) == 1:
            lowest = chord.nearest(-STEPS - 3 if "right" in hands else 3)
            yield from _held_chord(sheet, bar, chord, lowest, sheet.thickness, _SOFT)
    yield from sheet.ending()


def _trill(sheet: EtudeSheet, bar: int, chord: Triad, main: int) -> Iterator[Tone]:
    """Yield main note and upper neighbour in turn; before the end the lower neighbour."""
    at = bar * sheet.bar
    for i in range(sheet.bar - 2):
        yield Tone(at + i, 1, sheet.pitch(main + i % 2, chord))
    yield Tone(at + sheet.bar - 2, 1, sheet.pitch(main - 1, chord))
    yield Tone(at + sheet.bar - 1, 1, sheet.pitch(main, chord))


def _held_chord(
    sheet: EtudeSheet, bar: int, chord: Triad, lowest: int, count: int, velocity: int
) -> Iterator[Tone]:
    """Yield `count` tones of a chord from its tone `lowest` upwards, held for a bar."""
    for pitch in sheet.voicing(chord, lowest, count):
        yield Tone(bar * sheet.bar, sheet.bar, pitch, velocity)


def arpeggios(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield arpeggios, up in the first half of each bar and down in the second."""
    half = sheet.bar // 2
    wave = [half - abs(half - i) for i in range(sheet.bar)]
    yield from _figures(sheet, wave, wave)


def broken_chords(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield broken chords, four notes on each inversion, upwards and downwards in turn."""
    cell = pick(sheet.rng, _CELLS)
    cells = range(sheet.bar // len(cell))
    rising = [inversion + tone for inversion in cells for tone in cell]
    falling = [inversion + tone for inversion in reversed(cells) for tone in cell]
    yield from _figures(sheet, rising, falling)


def _figures(sheet: EtudeSheet, odd: Sequence[int], even: Sequence[int]) -> Iterator[Tone]:
    """Yield figures of odd and even bars, as tones of a chord; an idle hand holds a chord."""
    *chords, _ = sheet.chords()
    # In the easiest etudes the other hand rests.
    size = 0 if sheet.difficulty <= 2 else 1 if sheet.difficulty == 3 else 3
    for bar, chord in enumerate(chords):
        figure = even if bar % 2 else odd
        hands = sheet.hands(bar)
        for hand in hands:
            lowest = chord.nearest(_HOME[hand])
            for i, tone in enumerate(figure):
                yield Tone(bar * sheet.bar + i, 1, sheet.pitch(chord.tone(lowest + tone), chord))
        if hands == ("right",):
            lowest = chord.nearest(2 - 2 * STEPS)
            yield from _held_chord(sheet, bar, chord, lowest, size, _CHORD)
        elif hands == ("left",):
            highest = chord.nearest(_HOME["left"]) + max(figure)
            lowest = max(highest + 2, chord.nearest(STEPS + 2))
            yield from _held_chord(sheet, bar, chord, lowest, size, _CHORD)
    yield from sheet.ending()


def repeated_notes(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield a melody of repeated notes over basses or chords."""
    *chords, _ = sheet.chords()
    below = (0, -2) if sheet.difficulty >= _REPEATED_THIRDS else (0,)
    for at, length, degree, chord in _melody(sheet, chords, 0, STEPS + 2, slow=True):
        for i in range(int(length)):
            for interval in below:
                yield Tone(at + i, _STACCATO, sheet.pitch(degree + interval, chord))
    for bar, chord in enumerate(chords):
        yield from _basses(sheet, bar, chord)
    yield from sheet.ending()


def _basses(sheet: EtudeSheet, bar: int, chord: Triad) -> Iterator[Tone]:
    """Yield the accompaniment of a bar: a bass, in harder etudes chords on beats or steps."""
    easy, hard = sheet.difficulty <= 2, sheet.difficulty >= 8
    every = sheet.bar if easy else 1 if hard else sheet.division
    count = 1 if sheet.difficulty < 4 or every == 1 else 2
    lowest = chord.nearest(-STEPS - 3)
    for at in range(0, sheet.bar, every):
        for i in range(count):
            pitch = sheet.pitch(chord.tone(lowest + 2 * i), chord)
            yield Tone(bar * sheet.bar + at, _STACCATO * every, pitch, _CHORD)


def _melody(
    sheet: EtudeSheet, chords: Sequence[Triad], low: int, high: int, slow: bool = False
) -> Iterator[tuple[float, float, int, Triad]]:
    """Yield the notes of a melody over a chord a bar: (at, length) in steps, degree, chord.

    Bars begin with a tone of the chord. Other notes are tones of the chord, too, or are reached and
    left by step. It moves between the degrees `low` and `high`, if `slow` without halves of beats.
    """
    notes = list(_melody_rhythm(sheet, chords, slow))
    degrees = np.arange(low, high + 1)
    interval = np.abs(degrees[:, None] - degrees)
    costs, chord_tones = [], []
    for at, _, chord in notes:
        belongs = np.array([chord.has(int(degree)) for degree in degrees])
        cost = random_costs(sheet.rng, len(degrees), _RANDOM)
        if at % sheet.bar == 0:
            cost[~belongs] = FORBIDDEN
        costs.append(cost)
        chord_tones.append(belongs)
    moves = np.where(
        interval < len(_INTERVAL_COSTS), _INTERVAL_COSTS[np.minimum(interval, STEPS)], FORBIDDEN
    )
    steps = [
        np.where((before[:, None] & after) | (interval == 1), moves, FORBIDDEN)
        for before, after in pairwise(chord_tones)
    ]
    for (at, length, chord), choice in zip(notes, cheapest_sequence(costs, steps), strict=True):
        yield at, length, int(degrees[choice]), chord


def _melody_rhythm(
    sheet: EtudeSheet, chords: Sequence[Triad], slow: bool
) -> Iterator[tuple[float, float, Triad]]:
    """Yield times and lengths of notes [steps], and chords. All phrases have the same rhythm."""
    known = _RHYTHMS[sheet.beats]
    if slow:
        known = tuple(rhythm for rhythm in known if all(beats % 1 == 0 for beats in rhythm))
    choices = known[: 2 + sheet.difficulty]
    rhythms = [pick(sheet.rng, choices) for _ in range(PHRASE)]
    rhythms[-1] = (sheet.beats,)
    for bar, chord in enumerate(chords):
        at = float(bar * sheet.bar)
        for beats in rhythms[bar % PHRASE]:
            yield at, beats * sheet.division, chord
            at += beats * sheet.division
