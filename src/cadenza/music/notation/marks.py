"""Marks on a sheet: clefs, tempos, dynamics and the pedal."""

from collections.abc import Iterable, Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np

from cadenza.music.formats.musicxml.marks import VELOCITIES
from cadenza.music.notation.metre import QUARTER, Metre
from cadenza.music.score import PEDAL_DOWN, Bar, PedalEvent
from cadenza.music.viterbi import cheapest_sequence

TREBLE, BASS = "G", "F"
_MIDDLE_LINE = {TREBLE: 71, BASS: 50}  # pitch: B4, D3
_STAFF = 9  # semitones from the middle line that need at most one ledger line
_UNUSUAL = 4  # weight of semitones beyond the staff in the clef of the other hand
_CHANGE_OF_CLEF = 30.5  # cost of a change, in semitones beyond the staff, summed over notes

_LEDGERS = 25  # semitones from the middle line from which on notes have an ottava ...
_BESIDE = 8  # ... if all notes of their measure are at least this far on that side

_TEMPO_ERROR = 0.01  # [s] by which times that follow from the tempos may differ
_FASTEST = 1e-3  # [s] of a quarter
_SHOWN = 0.12  # relative change of tempo, over two measures, with a metronome mark
_LOUDER = 12  # change of the median velocity, over two measures, with a dynamic mark
_MUCH_LOUDER = 24  # change of the median velocity of a single measure with a dynamic mark
_MIN_STEP = 4  # change of the median velocity from each measure of a hairpin to the next
_PARTS = 4  # parts of a cell on which words and marks of the pedal stand


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
        [
            sum(max(0, abs(pitch - _MIDDLE_LINE[kind]) - _STAFF) for pitch in measure)
            for kind in kinds
        ]
        for measure in pitches
    ]
    costs = list(np.array(beyond) * (1, _UNUSUAL))
    change = _CHANGE_OF_CLEF * (1 - np.eye(2))
    costs[0] = costs[0] + change[0]
    return [kinds[i] for i in cheapest_sequence(costs, [change] * (len(costs) - 1))]


def octaves(pitches: Sequence[Sequence[int]], clefs: Sequence[str]) -> list[int]:
    """The ottava of each measure: 1 for an 8va, -1 for an 8vb, 0 for none, from its `pitches`."""
    shifts = []
    for measure, clef in zip(pitches, clefs, strict=True):
        beyond = [pitch - _MIDDLE_LINE[clef] for pitch in measure] or [0]
        is_high = clef == TREBLE and max(beyond) >= _LEDGERS and min(beyond) >= _BESIDE
        is_low = clef == BASS and min(beyond) <= -_LEDGERS and max(beyond) <= -_BESIDE
        shifts.append(int(is_high) - int(is_low))
    return shifts


def tempos(metre: Metre, bars: Iterable[Bar] = ()) -> list[TempoMark]:
    """The tempos from which the times of all cells follow to 0.01 s.

    The swing filter holds each tempo as long as possible (Elmeleegy et al. 2009, Online Piece-wise
    Linear Approximation of Numerical Streams with Precision Guarantees). The first tempo is shown.
    A later one is shown if the music is clearly faster or slower for longer than a measure; a
    gradual change is shown where it becomes clear. The words are those of the `bars`.
    """
    changes = _changes((metre.ticks / QUARTER).tolist(), metre.times.tolist())
    seconds_at = {int(metre.ticks[cell]): seconds for cell, seconds in changes.items()}
    due_ticks = _ticks_of_shown_tempos(metre)
    marks = []
    seconds = latest = 0.0
    is_due = False
    once = ({text: time for time, text in reversed(bar.words)} for bar in bars)
    texts = [(t, text) for each in once for text, t in each.items() if t < metre.times[-1]]
    words = {_tick_near(metre, max(time, float(metre.times[0]))): text for time, text in texts}
    for tick in sorted({*seconds_at, *due_ticks, *words}):
        seconds = seconds_at.get(tick, seconds)
        is_due |= tick in due_ticks
        is_shown = is_due and (not latest or abs(np.log(seconds / latest)) > _SHOWN)
        if is_shown:
            latest, is_due = seconds, False
        marks.append(TempoMark(tick, seconds, is_shown, words.get(tick, "")))
    return marks


def _changes(quarters: list[float], times: list[float]) -> dict[int, float]:
    """Indices of cells at which a new tempo begins, and the length of a quarter from there [s]."""
    changes: dict[int, float] = {}
    cell, time = 0, times[0]
    while cell < len(times) - 1:
        last, seconds = _longest(quarters, times, cell, time)
        changes[cell] = seconds
        time += seconds * (quarters[last] - quarters[cell])
        cell = last
    return changes


def _longest(
    quarters: list[float], times: list[float], first: int, begin: float
) -> tuple[int, float]:
    """The last cell of the longest steady tempo from `first`, at `begin` [s], and that tempo."""
    shortest, longest, last = _FASTEST, float("inf"), first
    for cell in range(first + 1, len(times)):
        length, passed = quarters[cell] - quarters[first], times[cell] - begin
        low, high = ((passed + error) / length for error in (-_TEMPO_ERROR, _TEMPO_ERROR))
        if last > first and max(low, shortest) > min(high, longest):
            break
        shortest, longest, last = max(low, shortest), min(high, longest), cell
    exact = (times[last] - begin) / (quarters[last] - quarters[first])
    return last, max(shortest, min(exact, longest))


def _ticks_of_shown_tempos(metre: Metre) -> set[int]:
    """The ticks of measures whose tempo is shown."""
    starts = [measure.start for measure in metre.measures]
    times = np.interp([*starts, metre.measures[-1].end], metre.ticks, metre.times)
    ticks = [measure.length for measure in metre.measures]
    pace = np.log(np.diff(times) / ticks)
    shown = {starts[0]}
    latest = pace[0]
    for start, (tempo, following) in zip(starts[1:], pairwise(pace[1:]), strict=False):
        if min(abs(tempo - latest), abs(following - latest)) > _SHOWN:
            latest = tempo
            shown.add(start)
    return shown


def dynamics(velocities: Sequence[Sequence[int]]) -> tuple[dict[int, str], dict[int, str]]:
    """The dynamic marks of measures from the velocities of their notes, and the ends of hairpins.

    Both are by the indices of measures: a hairpin begins with "crescendo" or "diminuendo" and ends
    with "stop". Within one there is no dynamic mark.
    """
    marks: dict[int, str] = {}
    latest = ""
    medians = [(i, float(np.median(values))) for i, values in enumerate(velocities) if values]
    hairpins = _hairpins(medians)
    inside = {i for begin, end in hairpins for i in range(begin, end)}
    ends = {end for _, end in hairpins}
    for (measure, velocity), (_, following) in pairwise([*medians, medians[-1]]):
        if not latest:  # a pickup may be a single note
            velocity = (velocity + following) / 2
        elif measure in inside or not (
            measure in ends
            or _is_change(velocity - VELOCITIES[latest], following - VELOCITIES[latest])
        ):
            continue
        nearest = min(VELOCITIES, key=lambda mark: abs(VELOCITIES[mark] - velocity))
        if nearest != latest:
            latest = marks[measure] = nearest
    wedges = {begin: kind for (begin, _), kind in hairpins.items()}
    return marks, wedges | dict.fromkeys(ends, "stop")


def _hairpins(medians: Sequence[tuple[int, float]]) -> dict[tuple[int, int], str]:
    """(begin, end), the measures at whose beginnings a hairpin begins and ends -> its kind.

    In the measures from the one before it to its end, the median velocity only rises, or only
    falls, and much in all. There are two of such steps or more, as one is a new dynamic.
    """
    hairpins: dict[tuple[int, int], str] = {}
    steps = [after - before for (_, before), (_, after) in pairwise(medians)]
    signs = [int(np.sign(step)) if abs(step) >= _MIN_STEP else 0 for step in steps]
    first = 0
    for sign, run in groupby(signs):
        last = first + len(list(run))
        change = medians[last][1] - medians[first][1]
        if sign and last - first > 1 and abs(change) > _MUCH_LOUDER:
            kind = "crescendo" if sign > 0 else "diminuendo"
            hairpins[medians[first + 1][0], medians[last][0]] = kind
        first = last
    return hairpins


def _is_change(change: float, next_change: float) -> bool:
    """Whether changes of velocity of a measure and of the next need a new dynamic mark."""
    if abs(change) > _MUCH_LOUDER:
        return True
    return change * next_change > 0 and min(abs(change), abs(next_change)) > _LOUDER


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
