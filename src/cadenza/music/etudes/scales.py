"""Etudes along the scale: scales, finger exercises in the manner of Hanon, drills for one hand."""

from collections.abc import Iterator

import numpy as np

from cadenza.music.etudes.harmony import STEPS, Key, random_key
from cadenza.music.etudes.sheet import EtudeSheet, Tone, pick
from cadenza.music.score import Note, Score

_OCTAVE_UP_AND_DOWN = 16  # steps of a scale over an octave, with the last note held
_TENTH = STEPS + 2  # degrees between the hands
_CONTRARY = 8  # difficulty from which the hands of a finger exercise may move against each other
_MAX_NOTES = 8  # notes of a figure


def scales(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield scales up and down over one, two or four octaves, the third in the relative key."""
    at, count = 0, 0
    while at < sheet.length:
        motion = _motion(sheet, count)
        octaves = 1 if sheet.difficulty <= 3 else 2 if sheet.difficulty <= 7 else 4
        octaves = min(octaves, (sheet.length - at) // _OCTAVE_UP_AND_DOWN)
        if motion == "contrary":
            octaves = min(octaves, 2)
        last = at + _OCTAVE_UP_AND_DOWN * octaves == sheet.length
        key = sheet.key.relative if count % 4 == 2 and not last else sheet.key
        if last and motion == "tenths":
            motion = "parallel"  # so that it ends on the tonic
        yield from _scale(key, motion, octaves, at)
        at += _OCTAVE_UP_AND_DOWN * octaves
        count += 1


def _motion(sheet: EtudeSheet, count: int) -> str:
    """The hand that plays the scale of this number, or the motion of both hands."""
    if sheet.difficulty <= 2:
        return ("right", "left")[count % 2]
    if sheet.difficulty == 3:
        return ("right", "left", "parallel")[min(count, 2)]
    if sheet.difficulty < 6 or count == 0:
        return "parallel"
    return pick(sheet.rng, ("parallel", "contrary", "tenths"))


def _scale(key: Key, motion: str, octaves: int, at: int) -> Iterator[Tone]:
    """Yield a scale up and down over one to four octaves from step `at` on."""
    top = STEPS * octaves
    degrees = [*range(top), *range(top, -1, -1)]
    low = -STEPS * (octaves // 4)
    for i, degree in enumerate(degrees):
        length = 1 if i < 2 * top else 2 * octaves
        right = STEPS + degree if motion == "contrary" else low + degree
        apart = _TENTH if motion == "tenths" else STEPS
        left = -degree if motion == "contrary" else right - apart
        if motion != "left":
            yield Tone(at + i, length, key.pitch(right, "harmonic"))
        if motion != "right":
            yield Tone(at + i, length, key.pitch(left, "harmonic"))


def hanon(sheet: EtudeSheet) -> Iterator[Tone]:
    """Yield a figure of up to eight notes that climbs the scale and, reversed, descends."""
    size = min(_MAX_NOTES, sheet.bar)
    figure = _figure(sheet, size)
    count = (sheet.length - sheet.bar) // size
    contrary = sheet.difficulty >= _CONTRARY and pick(sheet.rng, (False, True))
    for unit in range(count):
        climbs = 2 * unit < count
        base = unit if climbs else count - 1 - unit
        hands = sheet.hands(unit * size // sheet.bar)
        for i, offset in enumerate(figure if climbs else figure[::-1]):
            at, degree = unit * size + i, base + offset
            if "right" in hands:
                yield Tone(at, 1, sheet.pitch(degree + STEPS * contrary))
            if "left" in hands:
                yield Tone(at, 1, sheet.pitch(-degree if contrary else degree - STEPS))
    yield from sheet.ending()


def _figure(sheet: EtudeSheet, size: int) -> list[int]:
    """Degrees above the first note, each different from its neighbours, within a sixth."""
    widest = min(2 + sheet.difficulty // 2, STEPS - 2)
    figure = [0]
    while len(figure) < size:
        step = pick(sheet.rng, (-2, -1, 1, 1, 2, 3))
        # The figure a degree higher follows: its first note has to be another, too.
        last = len(figure) == size - 1
        if 0 <= figure[-1] + step <= widest and not (last and figure[-1] + step == 1):
            figure.append(figure[-1] + step)
    return figure


DRILLS = {"notes": 1, "dyads": 2, "triads": 3, "tetrads": 4}
"""Kind -> how many keys are pressed at once."""
_LOWEST, _HIGHEST = 48, 72  # C3 to C5, the keys of the mini keyboard
_BEAT, _LENGTH = 0.75, 0.5  # [s] from one note to the next, and of each
_ACCIDENTALS = 2  # at most
_MAX_STEP = 4  # degrees from one note or chord to the next
_DYADS = (2, 5)  # degrees between the notes of a dyad: a third to a sixth


def drill(kind: str, count: int, rng: np.random.Generator) -> Score:
    """`count` notes or chords of one scale, each different from the one before and near it."""
    key = random_key(rng, _ACCIDENTALS)
    pitches = map(key.pitch, range(-2 * STEPS, 2 * STEPS + 1))
    scale = [pitch for pitch in pitches if _LOWEST <= pitch <= _HIGHEST]
    notes: list[Note] = []
    lowest: int | None = None
    for start in _BEAT * np.arange(count):
        intervals = _random_intervals(DRILLS[kind], rng)
        places = np.arange(len(scale) - intervals[-1])
        if lowest is not None:
            step = np.abs(places - lowest)
            places = places[(step > 0) & (step <= _MAX_STEP)]
        lowest = int(rng.choice(places))
        notes += [Note(float(start), start + _LENGTH, scale[lowest + i]) for i in intervals]
    return Score(tuple(notes), title=f"{kind.capitalize()} in {key.name}, {count}")


def _random_intervals(size: int, rng: np.random.Generator) -> list[int]:
    """Degrees of a chord's notes above its lowest: stacked thirds, or an inversion of them."""
    if size == 2:
        return [0, int(rng.integers(*_DYADS, endpoint=True))]
    intervals = np.full(size - 1, 2)
    if size > 2:
        intervals[rng.integers(size - 1)] += rng.integers(2)
    return [0, *np.cumsum(intervals).tolist()]
