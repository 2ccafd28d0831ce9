"""Marks on a sheet: clefs, tempos, dynamics and the pedal."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from cadenza.music.formats.musicxml.marks import VELOCITIES
from cadenza.music.notation.metre import QUARTER, Metre
from cadenza.music.score import PEDAL_DOWN, Bar, PedalEvent
from cadenza.music.viterbi import cheapest_sequence

TREBLE, BASS = "G", "F"
_MIDDLE_LINE = {TREBLE: 71, BASS: 50}  # pitch: B4, D3
_STAFF = 9  # semitones from the middle line that need at most one ledger line
_UNUSUAL = 4  # weight of these in the clef of the other hand
_CHANGE_OF_CLEF = 30.5  # semitones beyond the staff, summed over notes, that one outweighs

_LEDGERS = 25  # semitones from the middle line from which on notes are written an octave nearer ...
_BESIDE = 8  # ... if all of their measure are this far on that side

_TEMPO_ERROR = 0.01  # [s] by which times that follow from the tempos may differ
_FASTEST = 1e-3  # [s] of a quarter
_SHOWN = 0.12  # relative change of tempo of two measures that is shown
_LOUDER = 12  # change of the median velocity of two measures that has a mark
_MUCH_LOUDER = 24  # change of that of a single measure that has one
_PARTS = 4  # of a cell, on which words and marks of the pedal stand


class TempoMark(NamedTuple):
    """A quarter lasts `seconds` [s] from `tick` on; `words` and the tempo may be `shown` there."""

    tick: int
    seconds: float
    shown: bool
    words: str = ""


class PedalMark(NamedTuple):
    """The pedal goes down or up at `tick`."""

    tick: int
    is_down: bool


def clefs(pitches: Sequence[Sequence[int]], usual: str) -> list[str]:
    """The clef of each measure of a staff, with the `pitches` of its notes; it begins as `usual`.

    By dynamic programming, notes far from the staff are weighed against changes of clef.
    """
    kinds = (usual, BASS if usual == TREBLE else TREBLE)
    beyond = [
        [sum(max(0, abs(pitch - _MIDDLE_LINE[kind]) - _STAFF) for pitch in here) for kind in kinds]
        for here in pitches
    ]
    costs = list(np.array(beyond) * (1, _UNUSUAL))
    change = _CHANGE_OF_CLEF * (1 - np.eye(2))
    costs[0] = costs[0] + change[0]
    return [kinds[i] for i in cheapest_sequence(costs, [change] * (len(costs) - 1))]


def octaves(pitches: Sequence[Sequence[int]], clefs: Sequence[str]) -> list[int]:
    """The octaves that each measure sounds above what is written: 1 for an 8va, -1 for an 8vb.

    `pitches` are those of its notes.
    """
    shifts = []
    for here, clef in zip(pitches, clefs, strict=True):
        beyond = [pitch - _MIDDLE_LINE[clef] for pitch in here] or [0]
        is_high = clef == TREBLE and max(beyond) >= _LEDGERS and min(beyond) >= _BESIDE
        is_low = clef == BASS and min(beyond) <= -_LEDGERS and max(beyond) <= -_BESIDE
        shifts.append(int(is_high) - int(is_low))
    return shifts


def tempos(metre: Metre, bars: Iterable[Bar] = ()) -> list[TempoMark]:
    """The tempos from which the times of all cells follow to 0.01 s.

    Each holds as long as it can, which the swing filter finds (Elmeleegy et al. 2009, Online
    Piece-wise Linear Approximation of Numerical Streams with Precision Guarantees). Shown are the
    first, and those of measures that are clearly faster or slower for longer than a measure: from
    where they clearly are, if they become so by degrees. Words are those of the `bars`.
    """
    changes = _changes((metre.ticks / QUARTER).tolist(), metre.times.tolist())
    seconds_at = {int(metre.ticks[cell]): seconds for cell, seconds in changes.items()}
    due = _shown(metre)
    marks = []
    seconds = latest = 0.0
    is_due = False
    said = [each for bar in bars for each in bar.words if each[0] < metre.times[-1]]
    words = {_tick_near(metre, max(time, float(metre.times[0]))): text for time, text in said}
    for tick in sorted({*seconds_at, *due, *words}):
        seconds = seconds_at.get(tick, seconds)
        is_due |= tick in due
        is_shown = is_due and (not latest or abs(np.log(seconds / latest)) > _SHOWN)
        if is_shown:
            latest, is_due = seconds, False
        marks.append(TempoMark(tick, seconds, is_shown, words.get(tick, "")))
    return marks


def _changes(quarters: list[float], times: list[float]) -> dict[int, float]:
    """Indices of cells at which a new tempo begins, and the length of a quarter from there [s]."""
    changes: dict[int, float] = {}
    cell, now = 0, times[0]
    while cell < len(times) - 1:
        last, seconds = _longest(quarters, times, cell, now)
        changes[cell] = seconds
        now += seconds * (quarters[last] - quarters[cell])
        cell = last
    return changes


def _longest(
    quarters: list[float], times: list[float], first: int, now: float
) -> tuple[int, float]:
    """Up to which cell a tempo can hold that begins at `first`, `now` [s], and that tempo."""
    least, most, last = _FASTEST, float("inf"), first
    for cell in range(first + 1, len(times)):
        length, passed = quarters[cell] - quarters[first], times[cell] - now
        low, high = ((passed + error) / length for error in (-_TEMPO_ERROR, _TEMPO_ERROR))
        if last > first and max(low, least) > min(high, most):
            break
        least, most, last = max(low, least), min(high, most), cell
    exact = (times[last] - now) / (quarters[last] - quarters[first])
    return last, max(least, min(exact, most))


def _shown(metre: Metre) -> set[int]:
    """The ticks of measures whose tempo is shown."""
    starts = [measure.start for measure in metre.measures]
    times = np.interp([*starts, metre.measures[-1].end], metre.ticks, metre.times)
    ticks = [measure.length for measure in metre.measures]
    pace = np.log(np.diff(times) / ticks)
    shown = {starts[0]}
    latest = pace[0]
    for start, (here, following) in zip(starts[1:], pairwise(pace[1:]), strict=False):
        if min(abs(here - latest), abs(following - latest)) > _SHOWN:
            latest = here
            shown.add(start)
    return shown


def dynamics(velocities: Sequence[Sequence[int]]) -> dict[int, str]:
    """The dynamic marks of measures, by their indices, from the velocities of their notes."""
    marks: dict[int, str] = {}
    latest = ""
    sounding = [(i, float(np.median(here))) for i, here in enumerate(velocities) if here]
    for (measure, here), (_, following) in pairwise([*sounding, sounding[-1]]):
        if not latest:  # a pickup may be a single note
            here = (here + following) / 2
        elif not _is_change(here - VELOCITIES[latest], following - VELOCITIES[latest]):
            continue
        nearest = min(VELOCITIES, key=lambda mark: abs(VELOCITIES[mark] - here))
        if nearest != latest:
            latest = marks[measure] = nearest
    return marks


def _is_change(here: float, following: float) -> bool:
    """Whether a measure that is so much louder than marked, and the next, need a new mark."""
    if abs(here) > _MUCH_LOUDER:
        return True
    return here * following > 0 and min(abs(here), abs(following)) > _LOUDER


def _tick_near(metre: Metre, time: float) -> int:
    """The tick of the quarter of a cell that is nearest to a time [s]."""
    at, ticks = float(metre.place([time])[0]), metre.ticks
    cell = min(int(np.searchsorted(ticks, at, "right")) - 1, len(ticks) - 2)
    part = int(ticks[cell + 1] - ticks[cell]) // _PARTS
    return int(ticks[cell]) + round((at - int(ticks[cell])) / part) * part


def pedal_marks(events: Sequence[PedalEvent], metre: Metre) -> list[PedalMark]:
    """The marks at which the pedal goes down and up by turns, on quarters of cells."""
    marks: list[PedalMark] = []
    for event in events:
        is_down = event.value >= PEDAL_DOWN
        if is_down == bool(marks and marks[-1].is_down):
            continue
        tick = _tick_near(metre, event.time)
        if not is_down and marks[-1].tick == tick:
            marks.pop()
        else:
            marks.append(PedalMark(tick, is_down))
    if marks and marks[-1].is_down:
        last = PedalMark(int(metre.ticks[-1]), False)
        marks = [*marks[:-1]] if marks[-1].tick == last.tick else [*marks, last]
    return marks
