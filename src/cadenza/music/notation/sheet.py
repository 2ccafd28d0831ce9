"""A score as it is written: measures, voices on two staves, note values and marks."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from cadenza.errors import CadenzaError
from cadenza.music.notation.hands import LEFT, RIGHT, staves
from cadenza.music.notation.marks import (
    BASS,
    TREBLE,
    PedalMark,
    Tempo,
    clefs,
    dynamics,
    pedal_marks,
    tempos,
)
from cadenza.music.notation.metre import Measure, metre_of
from cadenza.music.notation.note_values import Divisions, Value, tuplet_values, values
from cadenza.music.notation.quantising import Stream, are_exact, quantised
from cadenza.music.notation.spelling import Spelling, spelled
from cadenza.music.notation.voices import LOWER, UPPER, Timed, voices
from cadenza.music.repair import counted_remarks
from cadenza.music.score import Note, Score

_USUAL_CLEF = {RIGHT: TREBLE, LEFT: BASS}


@dataclass(frozen=True, slots=True)
class Symbol:
    """A chord, or a rest without notes, of one value; `tied` to the one before or `ties` on."""

    value: Value
    notes: tuple[tuple[Note, Spelling], ...] = ()
    tied: bool = False
    ties: bool = False


@dataclass(frozen=True, slots=True)
class Staff:
    """A staff of a measure: its clef, and one or two voices, each a list of symbols.

    A voice without symbols rests. The second voice has no symbols where it rests.
    """

    clef: str
    voices: tuple[tuple[Symbol, ...], ...]


@dataclass(frozen=True, slots=True)
class WrittenMeasure:
    """A measure with its staves, the upper first, its dynamic mark if any, tempos and pedal."""

    measure: Measure
    divisions: Divisions
    staves: tuple[Staff, Staff]
    dynamic: str | None
    tempos: tuple[Tempo, ...]
    pedal: tuple[PedalMark, ...]


@dataclass(frozen=True, slots=True)
class Sheet:
    """A written score; `remarks` say in plain words where it differs from what is played.

    `key` is the number of sharps of its key signature, negative for flats.
    """

    title: str
    key: int
    measures: tuple[WrittenMeasure, ...]
    remarks: tuple[str, ...]


def sheet_of(score: Score) -> Sheet:
    """Writes a score, whose times may be those of a performance, for piano.

    Raises:
        CadenzaError: it has no notes.
    """
    if not score.notes:
        raise CadenzaError("there are no notes to be written")
    metre = metre_of(score)
    onsets = metre.place([note.start for note in score.notes]).tolist()
    ends = metre.place([note.end for note in score.notes]).tolist()
    is_exact = are_exact(onsets, metre)
    hands = staves(score.notes)
    timed = [Timed(*each) for each in zip(score.notes, onsets, ends, strict=True)]
    parts: list[list[Timed]] = []
    for hand in (RIGHT, LEFT):
        own = [each for each, where in zip(timed, hands, strict=True) if where == hand]
        chosen = voices(own, is_exact)
        for voice in (UPPER, LOWER):
            parts.append([each for each, v in zip(own, chosen, strict=True) if v == voice])
    streams, left_out = quantised(parts, metre, is_exact)
    key, spellings = spelled(score.notes)
    names = {id(note): name for note, name in zip(score.notes, spellings, strict=True)}
    divisions = [Divisions(measure) for measure in metre.measures]
    cells = metre.ticks.tolist()
    written = [
        _written(stream, metre.measures, divisions, cells, names, is_first=v % 2 == UPPER)
        for v, stream in enumerate(streams)
    ]
    begins = [measure.start for measure in metre.measures]
    pitches = [_by_measure(begins, streams[2 * hand : 2 * hand + 2], "pitch") for hand in (0, 1)]
    marks = dynamics(_by_measure(begins, streams, "velocity"))
    timed_tempos = _grouped(begins, tempos(metre))
    pedal = _grouped(begins, pedal_marks(score.pedal, metre))
    of_staves = [
        [
            Staff(clef, _used(*pair))
            for clef, pair in zip(
                clefs(pitches[hand], _USUAL_CLEF[hand]),
                zip(written[2 * hand], written[2 * hand + 1], strict=True),
                strict=True,
            )
        ]
        for hand in (RIGHT, LEFT)
    ]
    measures = tuple(
        WrittenMeasure(
            measure,
            divisions[i],
            (of_staves[RIGHT][i], of_staves[LEFT][i]),
            marks.get(i),
            tuple(timed_tempos[i]),
            tuple(pedal[i]),
        )
        for i, measure in enumerate(metre.measures)
    )
    remarks = counted_remarks([(left_out, "note", "left out, struck again too soon to be written")])
    return Sheet(score.title, key, measures, (*metre.remarks, *remarks))


def _by_measure(begins: list[int], streams: Sequence[Stream], what: str) -> list[list[int]]:
    """By measures, an attribute of the notes that begin in them."""
    found: list[list[int]] = [[] for _ in begins]
    for stream in streams:
        for chord in stream.chords:
            here = found[bisect_right(begins, chord.start) - 1]
            here += [getattr(note, what) for note in chord.notes]
    return found


def _grouped(begins: list[int], marks: Sequence) -> defaultdict[int, list]:  # type: ignore[type-arg]
    by_measure = defaultdict(list)
    for mark in marks:
        by_measure[bisect_right(begins, mark.tick) - 1].append(mark)
    return by_measure


def _used(first: tuple[Symbol, ...], second: tuple[Symbol, ...]) -> tuple[tuple[Symbol, ...], ...]:
    """The voices with notes, of the two of a staff in a measure."""
    sounding = [voice for voice in (first, second) if any(symbol.notes for symbol in voice)]
    return tuple(sounding) or ((),)


def _written(
    stream: Stream,
    measures: Sequence[Measure],
    divisions: Sequence[Divisions],
    cells: list[int],
    names: dict[int, Spelling],
    is_first: bool,
) -> list[tuple[Symbol, ...]]:
    """The symbols of a voice in each measure, with rests."""
    found = []
    at = 0
    for measure, division in zip(measures, divisions, strict=True):
        symbols: list[Symbol] = []
        now = measure.start
        while now < measure.end:
            while at < len(stream.chords) and stream.chords[at].end <= now:
                at += 1
            chord = stream.chords[at] if at < len(stream.chords) else None
            if chord is None or chord.start >= measure.end:
                symbols += _pieces(now, measure.end, stream, division, cells)
                break
            if chord.start > now:
                symbols += _pieces(now, chord.start, stream, division, cells)
                now = chord.start
            end = min(chord.end, measure.end)
            notes = tuple(
                (note, names[id(note)]) for note in sorted(chord.notes, key=lambda n: n.pitch)
            )
            symbols += (
                Symbol(
                    piece.value, notes, piece.value.start > chord.start, piece.value.end < chord.end
                )
                for piece in _pieces(now, end, stream, division, cells, is_rest=False)
            )
            now = end
        found.append(tuple(symbols))
    return found


def _pieces(
    start: int,
    end: int,
    stream: Stream,
    divisions: Divisions,
    cells: list[int],
    is_rest: bool = True,
) -> Iterator[Symbol]:
    """Yields rests for a stretch; it is broken where tuplets begin and end."""
    now = start
    cell = bisect_right(cells, start) - 1
    while now < end:
        if parts := stream.tuplets.get(cell):
            stop = min(end, cells[cell + 1])
            found = tuplet_values(now, stop, cells[cell], cells[cell + 1], parts)
        else:
            last = cell
            while (
                last + 1 < len(cells) - 1
                and cells[last + 1] < end
                and (last + 1 not in stream.tuplets)
            ):
                last += 1
            stop = min(end, cells[last + 1])
            found = values(now, stop, divisions, is_rest)
            cell = last
        for value in found:
            yield Symbol(value)
        now, cell = stop, cell + 1
