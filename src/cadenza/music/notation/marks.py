"""Marks on a sheet: clefs, tempos, dynamics and the pedal."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cadenza.music.formats.musicxml_marks import VELOCITIES
from cadenza.music.notation.metre import QUARTER, Metre
from cadenza.music.score import PedalEvent

TREBLE, BASS = "G", "F"
_MIDDLE_LINE = {TREBLE: 71, BASS: 50}  # pitch: B4, D3
_STAFF = 9  # semitones from the middle line that need at most one ledger line
_CHANGE_OF_CLEF = 30.0  # semitones beyond the staff, summed over notes, that outweigh a change

_TEMPO_ERROR = 0.01  # [s] by which times that follow from the tempos may differ
_SHOWN = 0.12  # relative change of tempo of two measures that is shown
_LOUDER = 12  # change of the median velocity of two measures that has a mark
_MUCH_LOUDER = 24  # change of that of a single measure that has one
_DOWN = 64  # the least value of a pedal that is down
_PEDAL_PARTS = 4  # of a cell, on which pedal marks stand


class Tempo(NamedTuple):
    """From `tick` on a quarter lasts so many `seconds` [s]; it may be `shown` as a mark."""

    tick: int
    seconds: float
    shown: bool


class PedalMark(NamedTuple):
    """The pedal goes down or up at `tick`."""

    tick: int
    is_down: bool


def clefs(pitches: Sequence[Sequence[int]], usual: str) -> list[str]:
    """The clef of each measure of a staff, with the `pitches` of its notes; it begins as `usual`.

    By dynamic programming, notes far from the staff are weighed against changes of clef.
    """
    kinds = (TREBLE, BASS)
    total = {kind: 0.0 if kind == usual else _CHANGE_OF_CLEF for kind in kinds}
    origins: list[dict[str, str]] = []
    for here in pitches:
        origin, arrived = {}, {}
        for kind in kinds:
            others = {k: total[k] + (k != kind) * _CHANGE_OF_CLEF for k in kinds}
            origin[kind] = min((kind, *kinds), key=others.__getitem__)
            beyond = (abs(pitch - _MIDDLE_LINE[kind]) - _STAFF for pitch in here)
            arrived[kind] = others[origin[kind]] + sum(max(0, each) for each in beyond)
        total = arrived
        origins.append(origin)
    at = min((usual, *kinds), key=total.__getitem__)
    chosen = []
    for origin in reversed(origins):
        chosen.append(at)
        at = origin[at]
    return chosen[::-1]


def tempos(metre: Metre) -> list[Tempo]:
    """The tempos from which the times of all cells follow to 0.01 s.

    Each holds as long as it can, which the swing filter finds (Elmeleegy et al. 2009, Online
    Piece-wise Linear Approximation of Numerical Streams with Precision Guarantees). Shown are the
    first, and those of measures that are clearly faster or slower for longer than a measure.
    """
    changes = _changes(metre)
    shown = _shown(metre)
    return [
        Tempo(tick, changes.get(tick, 0.0) or _at(changes, tick), tick in shown)
        for tick in sorted({*changes, *shown})
    ]


def _at(changes: dict[int, float], tick: int) -> float:
    return changes[max(each for each in changes if each <= tick)]


def _changes(metre: Metre) -> dict[int, float]:
    ticks, times = metre.ticks / QUARTER, metre.times
    begin, begin_time = 0, float(times[0])
    least, most = 0.0, float("inf")
    changes: dict[int, float] = {}
    for i in range(1, len(ticks)):
        quarters = ticks[i] - ticks[begin]
        low = (times[i] - _TEMPO_ERROR - begin_time) / quarters
        high = (times[i] + _TEMPO_ERROR - begin_time) / quarters
        if max(low, least) > min(high, most):
            slope = _slope(least, most, times, ticks, begin, begin_time, i - 1)
            changes[int(metre.ticks[begin])] = slope
            begin_time += slope * (ticks[i - 1] - ticks[begin])
            begin = i - 1
            quarters = ticks[i] - ticks[begin]
            least = (times[i] - _TEMPO_ERROR - begin_time) / quarters
            most = (times[i] + _TEMPO_ERROR - begin_time) / quarters
        else:
            least, most = max(low, least), min(high, most)
    slope = _slope(least, most, times, ticks, begin, begin_time, len(ticks) - 1)
    changes[int(metre.ticks[begin])] = slope
    return changes


def _slope(  # noqa: PLR0913
    least: float,
    most: float,
    times: np.ndarray,
    ticks: np.ndarray,
    begin: int,
    begin_time: float,
    end: int,
) -> float:
    """The length of a quarter [s] that ends nearest to the time of `end`."""
    exact = (float(times[end]) - begin_time) / float(ticks[end] - ticks[begin])
    return min(max(exact, least, 1e-3), most)


def _shown(metre: Metre) -> set[int]:
    shown: dict[int, float] = {}
    latest = 0.0
    starts = [measure.start for measure in metre.measures]
    ends = [measure.end for measure in metre.measures]
    begin, end = (np.interp(at, metre.ticks, metre.times) for at in (starts, ends))
    lengths = (end - begin) / (np.array(ends) - starts)  # [s] of a tick
    for i, start in enumerate(starts):
        following = lengths[min(i + 1, len(lengths) - 1)]
        if not latest or all(
            abs(np.log(length / latest)) > _SHOWN for length in (lengths[i], following)
        ):
            latest = shown[start] = lengths[i]
    return set(shown)


def dynamics(velocities: Sequence[Sequence[int]]) -> dict[int, str]:
    """The dynamic marks of measures, by their indices, from the velocities of their notes."""
    marks: dict[int, str] = {}
    latest = None
    for measure, here in enumerate(velocities):
        if not here:
            continue
        median = float(np.median(here))
        following = next((each for each in velocities[measure + 1 :] if each), here)
        if latest is None:  # a pickup may be a single note
            median = float(np.median([*here, *following]))
        else:
            now, then = (m - VELOCITIES[latest] for m in (median, float(np.median(following))))
            if abs(now) < _LOUDER or (abs(now) < _MUCH_LOUDER and now * then < _LOUDER**2):
                continue
        nearest = min(VELOCITIES, key=lambda mark: abs(VELOCITIES[mark] - median))
        if nearest != latest:
            latest = marks[measure] = nearest
    return marks


def pedal_marks(events: Sequence[PedalEvent], metre: Metre) -> list[PedalMark]:
    """The marks at which the pedal goes down and up by turns, on quarters of cells."""
    marks: list[PedalMark] = []
    ticks = metre.ticks
    for event in events:
        is_down = event.value >= _DOWN
        if is_down == bool(marks and marks[-1].is_down):
            continue
        at = float(metre.place(event.time))
        cell = min(int(np.searchsorted(ticks, at, "right")) - 1, len(ticks) - 2)
        part = int(ticks[cell + 1] - ticks[cell]) // _PEDAL_PARTS
        tick = int(ticks[cell]) + round((at - int(ticks[cell])) / part) * part
        if not is_down and marks[-1].tick == tick:
            marks.pop()
        else:
            marks.append(PedalMark(tick, is_down))
    if marks and marks[-1].is_down:
        last = PedalMark(int(ticks[-1]), False)
        marks = [*marks[:-1]] if marks[-1].tick == last.tick else [*marks, last]
    return marks
