"""A score as it is written: measures, voices on two staves, note values and marks."""

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.fingers import LEFT, RIGHT
from cadenza.music.notation.marks import (
    BASS,
    TREBLE,
    PedalMark,
    TempoMark,
    clefs,
    dynamics,
    octaves,
    pedal_marks,
    tempos,
)
from cadenza.music.notation.metre import Measure, Metre, metre_of
from cadenza.music.notation.note_values import Divisions, Value, tuplet_values, values
from cadenza.music.notation.quantising import Stream, are_exact, on_grid, quantised
from cadenza.music.notation.rolls import Roll, unrolled
from cadenza.music.notation.spelling import Spelling, spelled, spelled_in
from cadenza.music.notation.voices import LOWER, UPPER, Timed, staves, voices
from cadenza.music.repair import counted_remarks
from cadenza.music.score import Note, Score

_Mark = TypeVar("_Mark", TempoMark, PedalMark)
_USUAL_CLEF = {RIGHT: TREBLE, LEFT: BASS}


@dataclass(frozen=True, slots=True)
class Symbol:
    """A chord, or a rest without notes, of one value; `tied` to the one before or `ties` on.

    `roll` is whether and how all or some of its notes are rolled.
    """

    value: Value
    notes: tuple[tuple[Note, Spelling], ...] = ()
    tied: bool = False
    ties: bool = False
    roll: Roll | None = None


@dataclass(frozen=True, slots=True)
class Staff:
    """A staff of a measure: its clef, and one or two voices, each a list of symbols.

    It sounds `octave` octaves above what is written.
    A voice without symbols rests. The second voice has no symbols where it rests.
    """

    clef: str
    voices: tuple[tuple[Symbol, ...], ...]
    octave: int = 0


@dataclass(frozen=True, slots=True)
class WrittenMeasure:
    """A measure with its staves, the upper first, its dynamic mark if any, tempos and pedal.

    A hairpin begins ("crescendo" or "diminuendo") or ends ("stop") with it if there is a `wedge`.
    What sounds at the ticks of `fermatas` has one.

    It begins at the time `begin` [s] and ends at `end`. `key` is the number of sharps of its key
    signature, negative for flats.
    """

    measure: Measure
    key: int
    begin: float
    end: float
    divisions: Divisions
    staves: tuple[Staff, Staff]
    dynamic: str | None
    wedge: str | None
    tempos: tuple[TempoMark, ...]
    pedal: tuple[PedalMark, ...]
    fermatas: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Sheet:
    """A written score; `remarks` say in plain words where it differs from what is played.

    It `is_sure` unless the song has no bars, and its onsets do not fit the estimated ones.
    """

    title: str
    measures: tuple[WrittenMeasure, ...]
    remarks: tuple[str, ...]
    is_sure: bool

    @property
    def symbols(self) -> Iterator[Symbol]:
        """Yield all chords and rests, measure by measure."""
        for written in self.measures:
            for staff in written.staves:
                for voice in staff.voices:
                    yield from voice

    @property
    def notes(self) -> tuple[Note, ...]:
        """The notes that are written, by (start, pitch)."""
        notes = [note for symbol in self.symbols if not symbol.tied for note, _ in symbol.notes]
        return tuple(sorted(notes, key=lambda note: (note.start, note.pitch)))


def sheet_of(score: Score) -> Sheet:
    """Write a score, maybe with times of a performance, for piano; CadenzaError without notes."""
    if not score.notes:
        raise CadenzaError("there are no notes to be written")
    metre = metre_of(score)
    places = (
        metre.place([getattr(n, end) for n in score.notes]).tolist() for end in ("start", "end")
    )
    played_notes = [Timed(*each) for each in zip(score.notes, *places, strict=True)]
    onsets = [each.onset for each in played_notes]
    is_exact = are_exact(onsets, metre)
    is_free = [not (is_exact and each) for each in on_grid(onsets, metre)]
    timed, rolls = unrolled(played_notes, staves(score.notes), is_free)
    is_exact |= are_exact([each.onset for each in timed], metre)
    streams, num_lost = _streams(timed, metre, is_exact)
    all_streams = [stream for pair in streams for stream in pair]
    keys, names = _keys_and_names(score.notes, all_streams, metre.measures)
    divisions = [Divisions(measure) for measure in metre.measures]
    begins = [measure.start for measure in metre.measures]
    of_hands = [
        _staves(streams[hand], _USUAL_CLEF[hand], metre, divisions, names, rolls)
        for hand in (RIGHT, LEFT)
    ]
    marks, wedges = dynamics(_by_measure(begins, all_streams, "velocity"))
    of_tempo = _grouped(begins, tempos(metre, score.bars))
    of_pedal = _grouped(begins, pedal_marks(score.pedal, metre))
    of_fermata: list[list[int]] = [[] for _ in begins]
    times_of_fermatas = [time for bar in score.bars for time in bar.fermatas]
    for tick in metre.place(times_of_fermatas).round().astype(int).tolist():
        of_fermata[max(bisect_right(begins, tick) - 1, 0)].append(tick)
    lines = [*begins, metre.measures[-1].end]
    times = np.interp(lines, metre.ticks, metre.times).tolist()
    measures = tuple(
        WrittenMeasure(
            measure,
            keys[i],
            times[i],
            times[i + 1],
            divisions[i],
            (of_hands[RIGHT][i], of_hands[LEFT][i]),
            marks.get(i),
            wedges.get(i),
            tuple(of_tempo[i]),
            tuple(of_pedal[i]),
            tuple(of_fermata[i]),
        )
        for i, measure in enumerate(metre.measures)
    )
    quantised = [] if is_exact else ["quantised: notes are moved to the nearest note values"]
    lost = counted_remarks([(num_lost, "note", "left out, struck again too soon to be written")])
    remarks, is_sure = (*metre.remarks, *quantised, *lost), bool(score.bars) or is_exact
    return Sheet(score.title, measures, remarks, is_sure)


def _keys_and_names(
    notes: Sequence[Note], streams: Sequence[Stream], measures: Sequence[Measure]
) -> tuple[list[int], dict[int, Spelling]]:
    """The key of each measure, estimated where the score tells none, and the names of notes.

    Names are by the ids of notes.
    """
    estimated, spellings = spelled(notes)
    names = {id(note): name for note, name in zip(notes, spellings, strict=True)}
    begins = [measure.start for measure in measures]
    for stream in streams:
        for chord in stream.chords:
            key = measures[bisect_right(begins, chord.start) - 1].key
            if key is not None:
                names |= ((id(n), spelled_in(key, names[id(n)])) for n in chord.notes)
    return [estimated if m.key is None else m.key for m in measures], names


def _streams(
    timed: Sequence[Timed], metre: Metre, is_exact: bool
) -> tuple[list[list[Stream]], int]:
    """The upper and the lower voice of each hand, and the number of notes left out."""
    hands = staves([each.note for each in timed])
    parts: list[list[Timed]] = []
    for hand in (RIGHT, LEFT):
        own_notes = [each for each, where in zip(timed, hands, strict=True) if where == hand]
        chosen = voices(own_notes, is_exact)
        parts += (
            [each for each, where in zip(own_notes, chosen, strict=True) if where == voice]
            for voice in (UPPER, LOWER)
        )
    streams, left_out = quantised(parts, metre, is_exact)
    return [streams[:2], streams[2:]], left_out


def _staves(
    streams: list[Stream],
    usual_clef: str,
    metre: Metre,
    divisions: Sequence[Divisions],
    names: dict[int, Spelling],
    rolls: dict[int, Roll],
) -> list[Staff]:
    """The staff of a hand in each measure."""
    begins = [measure.start for measure in metre.measures]
    pitches = _by_measure(begins, streams, "pitch")
    changing = clefs(pitches, usual_clef)
    cells = metre.ticks.tolist()
    written = [
        _symbols_of_bars(stream, metre.measures, divisions, cells, names, rolls)
        for stream in streams
    ]
    return [
        Staff(clef, _used(upper, lower), octave)
        for clef, octave, upper, lower in zip(
            changing, octaves(pitches, changing), *written, strict=True
        )
    ]


def _by_measure(begins: list[int], streams: Sequence[Stream], attribute: str) -> list[list[int]]:
    """The values that an attribute has for the notes that begin in each measure."""
    values: list[list[int]] = [[] for _ in begins]
    for stream in streams:
        for chord in stream.chords:
            measure_values = values[bisect_right(begins, chord.start) - 1]
            measure_values += [getattr(note, attribute) for note in chord.notes]
    return values


def _grouped(begins: list[int], marks: Iterable[_Mark]) -> defaultdict[int, list[_Mark]]:
    """Marks by the indices of the measures in which they stand."""
    by_measure: defaultdict[int, list[_Mark]] = defaultdict(list)
    for mark in marks:
        by_measure[bisect_right(begins, mark.tick) - 1].append(mark)
    return by_measure


def _used(first: tuple[Symbol, ...], second: tuple[Symbol, ...]) -> tuple[tuple[Symbol, ...], ...]:
    """The voices with notes, of the two of a staff in a measure."""
    used = [voice for voice in (first, second) if any(symbol.notes for symbol in voice)]
    return tuple(used) or ((),)


def _symbols_of_bars(
    stream: Stream,
    measures: Sequence[Measure],
    divisions: Sequence[Divisions],
    cells: list[int],
    names: dict[int, Spelling],
    rolls: dict[int, Roll],
) -> list[tuple[Symbol, ...]]:
    """The symbols of a voice in each measure, with rests."""
    bars = []
    chords = iter(stream.chords)
    chord = next(chords, None)
    for measure, division in zip(measures, divisions, strict=True):
        symbols: list[Symbol] = []
        now = measure.start
        while now < measure.end:
            while chord is not None and chord.end <= now:
                chord = next(chords, None)
            if chord is None or chord.start > now:
                end = measure.end if chord is None else min(chord.start, measure.end)
                rests = _values(now, end, stream, division, cells, is_rest=True)
                symbols += map(Symbol, rests)
            else:
                end = min(chord.end, measure.end)
                in_order = sorted(chord.notes, key=lambda note: note.pitch)
                notes = tuple((note, names[id(note)]) for note in in_order)
                roll = next((rolls[id(n)] for n in in_order if id(n) in rolls), None)
                symbols += (
                    Symbol(
                        *(value, notes, value.start > chord.start, value.end < chord.end),
                        roll if value.start == chord.start else None,
                    )
                    for value in _values(now, end, stream, division, cells, is_rest=False)
                )
            now = end
        bars.append(tuple(symbols))
    return bars


def _values(
    start: int, end: int, stream: Stream, divisions: Divisions, cells: list[int], is_rest: bool
) -> Iterator[Value]:
    """Yield the note values of a stretch, which is broken where tuplets begin and end."""
    cell = bisect_right(cells, start) - 1
    while start < end:
        tuplet = stream.tuplet_at(cell)
        cell = tuplet[2] if tuplet else cell + 1
        while not tuplet and cells[cell] < end and cell not in stream.tuplets:
            cell += 1
        stop = min(end, cells[cell])
        if tuplet:
            parts, first, _ = tuplet
            yield from tuplet_values(start, stop, cells[first], cells[cell], parts)
        else:
            yield from values(start, stop, divisions, is_rest)
        start = stop
