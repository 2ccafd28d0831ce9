"""The measures of a score, and the place in them of any time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.music.notation.beats import accents_of, estimated_bars
from cadenza.music.score import CHORD_TOLERANCE, Bar, Note, Score, chords

QUARTER = 1680
"""Ticks of a quarter: whole numbers of them make 64ths, triplets, quintuplets and septuplets."""
WHOLE = 4 * QUARTER
_UNKNOWN_BEATS = 4  # in a bar whose beats are unknown
_USUAL_BEAT = 0.5  # [s] of a quarter, where a single beat is all that is known
_SHORTEST = 1e-3  # [s] of a beat; less is a rounding error
_LONGEST = 8.0  # [s] of a bar whose beats are unknown
_LATE = 0.25  # beats after the last bar, up to which no other bar is added
_MAX_ADDED = 10_000  # bars before the first or after the last
_PICKUP_STEP = QUARTER // 4  # a 16th; a grace note that begins a file may shift it by one
_NEAR = QUARTER // 16  # ticks about a bar line that are at it
_HELD = 2.0  # accents that a chord held across a bar line outweighs
_CLEARLY_BETTER = 1.0  # gain of moved bar lines by `_fit` a bar; known pickups gain 1.1 to 7


@dataclass(frozen=True, slots=True)
class Measure:
    """A measure from tick `start` to tick `end`, with a time signature.

    A measure that `is_part` is shorter than its time signature `written`, such as a pickup, which
    is the end of a whole measure; such a one would begin at the tick `origin`. `key` is its number
    of sharps, negative for flats, if the score tells.
    """

    number: int
    start: int
    end: int
    written: tuple[int, int]
    origin: int
    is_part: bool = False
    key: int | None = None

    @property
    def length(self) -> int:
        """Its length [ticks]."""
        return self.end - self.start


class Metre(NamedTuple):
    """The measures, and a map of time: at `times` [s] lie `ticks`, both of shape (C + 1,).

    Between two of them lies a cell: a beat, or a quarter of one that is longer. Tempo is taken to
    be constant within a cell. `remarks` say in plain words what is not as in the score.
    """

    measures: tuple[Measure, ...]
    times: NDArray[np.float64]
    ticks: NDArray[np.int64]
    remarks: tuple[str, ...] = ()

    def place(self, times: Sequence[float]) -> NDArray[np.float64]:
        """The ticks, with fractions, of times [s]; those outside are moved to the nearest end."""
        return np.interp(times, self.times, self.ticks)


def metre_of(score: Score) -> Metre:
    """The measures of a score with notes, from the one of its first note to that of its last.

    They follow `Score.bars`, but for a pickup that a MIDI file does not tell. A score without any
    gets bars of a metre that is estimated.
    """
    timed = _timed(score.bars)
    is_estimated = not timed
    if is_estimated:
        timed = _timed(estimated_bars(score.notes))
    first, end = score.notes[0].start, score.total_time
    if first < timed[0].times[0] - CHORD_TOLERANCE:
        while first < timed[0].times[0] - CHORD_TOLERANCE and len(timed) < _MAX_ADDED:
            timed.insert(0, timed[0].repeated(-1))
        timed[0] = timed[0].since(first)
    while len(timed) > 1 and timed[0].times[-1] <= first + CHORD_TOLERANCE:
        del timed[0]
    last_start = score.notes[-1].start
    for _ in range(_MAX_ADDED):
        late = timed[-1].times[-1] + _LATE * timed[-1].last_beat
        if end <= late and last_start < timed[-1].times[-1]:
            break
        timed.append(timed[-1].repeated(1))
    metre = _metre(_numbered(timed))
    if is_estimated:
        return metre._replace(remarks=("the song has no bars: beats and bars are estimated",))
    is_midi = not score.tracks or any(track.channel for track in score.tracks)
    return _with_pickup(metre, score.notes) if is_midi else metre


@dataclass(frozen=True, slots=True)
class _TimedBar:
    """A bar with the times at which its beats begin, and last its end [s]."""

    number: int
    times: tuple[float, ...]
    beat_type: int
    key: int | None

    @property
    def last_beat(self) -> float:
        return self.times[-1] - self.times[-2]

    @property
    def signature(self) -> tuple[int, int]:
        return len(self.times) - 1, self.beat_type

    def repeated(self, direction: int) -> _TimedBar:
        """The bar after it (1) or before it (-1), with the same metre and tempo."""
        length = direction * (self.times[-1] - self.times[0])
        times = tuple(time + length for time in self.times)
        return replace(self, number=self.number + direction, times=times)

    def since(self, start: float) -> _TimedBar:
        """Its last beats, from that in which `start` [s] lies."""
        index = bisect_right(self.times, start + CHORD_TOLERANCE) - 1
        return replace(self, times=self.times[min(index, len(self.times) - 2) :])


def _timed(bars: Sequence[Bar]) -> list[_TimedBar]:
    timed: list[_TimedBar] = []
    beat = _USUAL_BEAT
    for bar, following in pairwise([*_without_long(bars), None]):
        assert bar is not None
        end = following.time if following else None
        beats = bar.beats or _even_beats(bar.time, end)
        if len(beats) > 1:
            beat = beats[-1] - beats[-2]
        if end is None:
            end = beats[-1] + max(beat, _SHORTEST)
        starts = [bar.time, *(each for each in beats[1:] if each < end - _SHORTEST)]
        if end - bar.time < _SHORTEST:  # bars that begin together
            continue
        timed.append(_TimedBar(bar.number, (*starts, end), bar.beat_type, bar.key))
        beat = timed[-1].last_beat
    return timed


def _without_long(bars: Sequence[Bar]) -> Iterator[Bar]:
    """Yield the bars, and several in place of one of unknown beats that no tempo could fill."""
    for bar, following in pairwise([*bars, None]):
        assert bar is not None
        length = 0.0 if bar.beats or following is None else following.time - bar.time
        parts = max(1, ceil(length / _LONGEST))
        yield from (replace(bar, time=bar.time + length * k / parts) for k in range(parts))


def _even_beats(start: float, end: float | None) -> tuple[float, ...]:
    beat = _USUAL_BEAT if end is None else (end - start) / _UNKNOWN_BEATS
    return tuple(start + n * beat for n in range(_UNKNOWN_BEATS))


def _numbered(bars: list[_TimedBar]) -> list[_TimedBar]:
    """The bars with their own numbers if these rise, which repeats prevent; or else from 1."""
    if all(a.number < b.number for a, b in pairwise(bars)) and bars[0].number >= 0:
        return bars
    return [replace(bar, number=number) for number, bar in enumerate(bars, start=1)]


def _metre(bars: list[_TimedBar]) -> Metre:
    measures: list[Measure] = []
    times, ticks = [bars[0].times[0]], [0]
    for bar in bars:
        start, beat = ticks[-1], WHOLE // bar.beat_type
        cells = max(1, beat // QUARTER)
        for begin, end in pairwise(bar.times):
            for cell in range(1, cells + 1):
                times.append(begin + (end - begin) * cell / cells)
                ticks.append(ticks[-1] + beat // cells)
        measures.append(Measure(bar.number, start, ticks[-1], bar.signature, start, key=bar.key))
    return Metre(tuple(_with_parts(measures)), np.array(times), np.array(ticks))


def _with_parts(measures: list[Measure]) -> list[Measure]:
    """The measures with those marked that are parts: a pickup, or two that make a whole one.

    A short first measure is a pickup if it has the number 0, or at most half the length of the next
    and of a later one; else it has a metre of its own.
    """
    marked = list(measures)
    if len(marked) > 1 and marked[0].length < marked[1].length:
        lengths = [measure.length for measure in marked]
        is_usual = lengths[1] in lengths[2:] or len(lengths) == 2  # nothing is usual
        if marked[0].number == 0 or (is_usual and 2 * lengths[0] <= lengths[1]):
            marked[0] = _pickup(marked[0], marked[1].written)
    for i in range(1, len(marked) - 1):
        previous, part, following = marked[i - 1 : i + 2]
        bar = WHOLE * previous.written[0] // previous.written[1]
        if not part.is_part and part.length + following.length == bar:
            marked[i] = replace(part, written=previous.written, is_part=True)
            marked[i + 1] = _pickup(following, previous.written)
    return marked


def _pickup(measure: Measure, signature: tuple[int, int]) -> Measure:
    """The measure as the end of one with that time signature."""
    origin = measure.end - WHOLE * signature[0] // signature[1]
    return replace(measure, written=signature, origin=origin, is_part=True)


def _with_pickup(metre: Metre, notes: Sequence[Note]) -> Metre:
    """The metre with bar lines moved to where they fit clearly better, after a pickup.

    Some programs write MIDI files without saying that the first bar is a pickup, so that all later
    ones begin too early. Pickups of over half a bar are rare, and not assumed.
    """
    first = metre.measures[0]
    signatures = {measure.written for measure in metre.measures}
    groups = list(chords(notes))
    onsets = metre.place([group[0].start for group in groups])
    ends = metre.place([max(note.end for note in group) for group in groups])
    if len(signatures) > 1 or first.is_part or onsets[0] > first.start + _NEAR:
        return metre
    shifts = range(0, first.length // 2 + 1, _PICKUP_STEP)
    accents = accents_of(groups)
    fits = [_fit(onsets - shift, ends - shift, accents, first.length) for shift in shifts]
    best = int(np.argmax(fits))
    if (fits[best] - fits[0]) / len(metre.measures) < _CLEARLY_BETTER:
        return metre
    beats = shifts[best] * first.written[1] / WHOLE
    remark = f"a pickup of {beats:g} beat{'s'[: beats != 1]} is assumed, which bar lines fit better"
    return _moved(metre, shifts[best])._replace(remarks=(remark,))


def _fit(
    onsets: NDArray[np.float64],
    ends: NDArray[np.float64],
    accents: NDArray[np.float64],
    length: int,
) -> float:
    """How well bar lines fit: accented chords begin at them, and few are held across them."""
    phase = (onsets + _NEAR) % length - _NEAR
    begins = phase < _NEAR
    held = ~begins & (phase + ends - onsets > length + _NEAR)
    return float(accents[begins].sum() - _HELD * held.sum())


def _moved(metre: Metre, pickup: int) -> Metre:
    """The metre with a `pickup` [ticks], and cells that begin with the measures."""
    written, length = metre.measures[0].written, metre.measures[0].length
    number, end = metre.measures[0].number, int(metre.ticks[-1])
    starts = [0, *range(pickup, end, length)]
    measures = []
    for i, (start, stop) in enumerate(pairwise([*starts, end])):
        origin = start if i else stop - length
        key = metre.measures[min(i, len(metre.measures) - 1)].key
        is_part = stop - start < length
        measures.append(Measure(number - 1 + i, start, stop, written, origin, is_part, key))
    cell = min(QUARTER, WHOLE // written[1])
    ticks = np.unique([0, *range(pickup % cell, end, cell), end])
    times = np.interp(ticks, metre.ticks, metre.times)
    return Metre(tuple(measures), times, ticks)
