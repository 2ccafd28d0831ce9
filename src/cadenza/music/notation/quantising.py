"""Quantisation: onsets and ends on a grid of note values."""

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from statistics import mean

from cadenza.music.notation.metre import QUARTER, Metre
from cadenza.music.notation.voices import Timed
from cadenza.music.score import Note, chords

# What it costs to divide a cell (a quarter, or a shorter beat) into parts. It is in units
# of what a deviation of an onset by `_SPREAD` costs twice; chosen by eye.
_GRIDS = {1: 0.0, 2: 0.3, 4: 0.8, 3: 1.2, 8: 2.0, 6: 2.2, 5: 4.0, 12: 6.0, 16: 4.5, 7: 4.5}
_SPREAD = 0.05  # standard deviation of onsets that are played, in cells ...
_MIN_SPREAD, _MAX_SPREAD = 0.025, 0.04  # [s] ... within these
_EXACT_SPREAD = 0.012  # [s] of onsets that are not
_COMMON = 12, 16, 5, 7  # parts of a cell, on which onsets are that nobody has played ...
_NEAR = 0.02 / 12  # ... up to so much of it
_MOSTLY = 0.8  # share of the onsets of such a file that are on a cell
_SHORTEST = 0.025  # [s] of a part of a grid
_FINEST = QUARTER // 16  # a 64th, which is a whole number of ticks
_APART = 0.5  # cost of grids that differ between voices
_MERGED = 1.5  # cost of chords that fall together
_REPEATED = 20.0  # cost of chords with the same pitch that fall together
_FILLED = 0.5  # share of the time to the next onset that needs no rest
_MAX_FILLED = QUARTER


@dataclass(slots=True)
class WrittenChord:
    """Notes of a voice that begin together at tick `start` and end at tick `end`."""

    notes: list[Note]
    start: int
    end: int


@dataclass(slots=True)
class Stream:
    """A voice: its chords in time, and by cell the number of parts if that is no power of two.

    From a cell in `wide` on, such parts divide two cells, as triplets of quarters do.
    """

    chords: list[WrittenChord] = field(default_factory=list)
    tuplets: dict[int, int] = field(default_factory=dict)
    wide: set[int] = field(default_factory=set)

    def tuplet_at(self, cell: int) -> tuple[int, int, int] | None:
        """The parts of the tuplet in a cell, the first cell that it divides and the one after it.

        None where there is no tuplet.
        """
        if cell not in self.tuplets:
            return None
        first = cell - 1 if cell - 1 in self.wide else cell
        return self.tuplets[cell], first, first + 1 + (first in self.wide)


@dataclass(slots=True)
class _OnsetGroup:
    """Notes of a voice that begin together, with onset and end in ticks, with fractions."""

    notes: list[Note]
    onset: float
    end: float


def are_exact(onsets: Sequence[float], metre: Metre) -> bool:
    """Whether `onsets` [ticks] are where notation has them, and not as somebody played."""
    return sum(on_grid(onsets, metre)) >= _MOSTLY * len(onsets)


def on_grid(onsets: Sequence[float], metre: Metre) -> list[bool]:
    """Find which `onsets` [ticks] are on the grid of the usual note values."""
    ticks = metre.ticks.tolist()
    are_on_grid = []
    for onset in onsets:
        cell = _cell(ticks, onset)
        at = (onset - ticks[cell]) / (ticks[cell + 1] - ticks[cell])
        are_on_grid.append(any(abs(at - round(at * parts) / parts) < _NEAR for parts in _COMMON))
    return are_on_grid


def quantised(
    voices: Sequence[Sequence[Timed]], metre: Metre, is_exact: bool
) -> tuple[list[Stream], int]:
    """The voices on a grid, and the number of notes left out.

    For each cell the grid is chosen that fits the onsets of all voices best; voices have grids of
    their own where that fits much better, as triplets against semiquavers do. A note is left out
    if its pitch is struck again so soon that both fall on one place of the finest grid.
    """
    ticks = metre.ticks.tolist()
    groups = [list(_groups(voice)) for voice in voices]
    by_cell: defaultdict[int, list[list[_OnsetGroup]]] = defaultdict(lambda: [[] for _ in voices])
    for v, of_voice in enumerate(groups):
        for group in of_voice:
            by_cell[_cell(ticks, group.onset)][v].append(group)
    grids: list[dict[int, int]] = [{} for _ in voices]
    starts: list[list[int]] = [[] for _ in voices]
    for cell in sorted(by_cell):
        begin, length = ticks[cell], ticks[cell + 1] - ticks[cell]
        seconds = float(metre.times[cell + 1] - metre.times[cell])
        onsets = [
            [((group.onset - begin) / length, group.notes) for group in of_voice]
            for of_voice in by_cell[cell]
        ]
        for v, grid in enumerate(_chosen(onsets, seconds, length, is_exact)):
            steps = [round(at * grid) for at, _ in onsets[v]]
            starts[v] += [begin + step * length // grid for step in steps]
            grids[v][cell] = _coarsest(grid, steps)
    num_lost = 0
    streams = []
    for v, of_voice in enumerate(groups):
        merged, lost = _merged(of_voice, starts[v])
        num_lost += lost
        streams.append(_stream(merged, grids[v], ticks))
        _widen(streams[-1], metre, ticks)
    return streams, num_lost


def _groups(voice: Sequence[Timed]) -> Iterator[_OnsetGroup]:
    """Yield the notes of a voice that begin together, at the mean of their onsets."""
    for group in chords(voice, start=lambda each: each.note.start):
        onset, end = mean(each.onset for each in group), max(each.end for each in group)
        yield _OnsetGroup([each.note for each in group], onset, end)


def _cell(ticks: list[int], at: float) -> int:
    return min(max(bisect_right(ticks, at) - 1, 0), len(ticks) - 2)


_Onsets = list[tuple[float, list[Note]]]


def _chosen(onsets: list[_Onsets], seconds: float, length: int, is_exact: bool) -> list[int]:
    """The grid of each voice in a cell of `seconds` [s] and `length` [ticks]."""
    usual_spread = min(max(_SPREAD * seconds, _MIN_SPREAD), _MAX_SPREAD)
    spread = (_EXACT_SPREAD if is_exact else usual_spread) / seconds
    possible = [
        grid
        for grid in _GRIDS
        if grid <= 2
        or (seconds / grid >= _SHORTEST and length % grid == 0 and length // grid >= _FINEST)
    ]
    deviations = [{grid: _deviation(each, grid, spread) for grid in possible} for each in onsets]
    joint = min(possible, key=lambda g: _GRIDS[g] + sum(each[g] for each in deviations))
    joint_cost = _GRIDS[joint] + sum(each[joint] for each in deviations)
    own_grids = [min(possible, key=lambda g: _GRIDS[g] + each[g]) for each in deviations]
    own_cost = sum(_GRIDS[g] + each[g] for g, each in zip(own_grids, deviations, strict=True))
    if own_cost + _APART * (len(set(own_grids)) - 1) < joint_cost:
        return own_grids
    return [joint] * len(onsets)


def _deviation(onsets: _Onsets, grid: int, spread: float) -> float:
    """The cost of moving the `onsets` of a voice to a grid."""
    cost, previous_step, pitches = 0.0, -1, set[int]()
    for at, notes in onsets:
        step = round(at * grid)
        cost += 0.5 * ((at - step / grid) / spread) ** 2
        step_pitches = {note.pitch for note in notes}
        if step == previous_step:
            cost += _REPEATED if pitches & step_pitches else _MERGED
            step_pitches |= pitches
        previous_step, pitches = step, step_pitches
    return cost


def _coarsest(grid: int, steps: list[int]) -> int:
    """The least divisor of `grid` that all `steps` are on."""
    return min(
        g for g in range(1, grid + 1) if grid % g == 0 and not any(s * g % grid for s in steps)
    )


def _merged(groups: list[_OnsetGroup], starts: list[int]) -> tuple[list[WrittenChord], int]:
    """Chords at their starts, with ends not yet on the grid, and the number of notes left out."""
    merged: list[WrittenChord] = []
    left_out = 0
    for group, start in zip(groups, starts, strict=True):
        if merged and merged[-1].start >= start:
            pitches = {note.pitch for note in merged[-1].notes}
            added = [note for note in group.notes if note.pitch not in pitches]
            left_out += len(group.notes) - len(added)
            merged[-1].notes += added
            merged[-1].end = max(merged[-1].end, round(group.end))
        else:
            merged.append(WrittenChord(list(group.notes), start, round(group.end)))
    return merged, left_out


def _stream(merged: list[WrittenChord], grids: dict[int, int], ticks: list[int]) -> Stream:
    """The chords with their ends on the grid."""
    for chord, following in zip_longest(merged, [chord.start for chord in merged[1:]]):
        shortest = _unit(_cell(ticks, chord.start), grids, ticks)
        end = max(_end(chord.end, grids, ticks), chord.start + shortest)
        if following is not None:
            gap = following - end
            is_short = gap <= _FILLED * (following - chord.start) and gap < _MAX_FILLED
            end = following if is_short else end
        chord.end = min(end, ticks[-1])
    return Stream(merged, {cell: grid for cell, grid in grids.items() if grid & (grid - 1)})


def _widen(stream: Stream, metre: Metre, ticks: list[int]) -> None:
    """Find tuplets that divide two cells: of the parts of each, every other one is used.

    The two are in one measure, and as long; of four beats, they are the first two or the last.
    """
    places = sorted({tick for chord in stream.chords for tick in (chord.start, chord.end)})
    starts = [measure.start for measure in metre.measures]
    for cell, parts in sorted(stream.tuplets.items()):
        if parts % 2 == 0 or stream.tuplets.get(cell + 1) != parts or cell - 1 in stream.wide:
            continue
        begin, middle, end = ticks[cell : cell + 3]
        measure = metre.measures[bisect_right(starts, begin) - 1]
        is_halved = measure.written[0] % 2 or (begin - measure.origin) % (end - begin) == 0
        inside = places[bisect_right(places, begin) : bisect_left(places, end)]
        used = all((tick - begin) * parts % (end - begin) == 0 for tick in inside)
        if is_halved and used and middle - begin == end - middle and middle < measure.end:
            stream.wide.add(cell)


def _end(at: int, grids: dict[int, int], ticks: list[int]) -> int:
    """The place on the grid that is nearest to the end of a note."""
    cell = _cell(ticks, at)
    unit = _unit(cell, grids, ticks)
    return ticks[cell] + round((at - ticks[cell]) / unit) * unit


def _unit(cell: int, grids: dict[int, int], ticks: list[int]) -> int:
    """The ticks of a part of a cell, which is the half of it if its onsets need none."""
    length, grid = ticks[cell + 1] - ticks[cell], grids.get(cell, 1)
    return length // (2 if grid == 1 and length // 2 >= _FINEST else grid)
