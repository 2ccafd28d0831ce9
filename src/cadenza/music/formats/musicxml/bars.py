"""The bars of a sheet, the order in which they are played, and all of it as it is played so."""

import re
from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from itertools import islice, pairwise
from operator import attrgetter, itemgetter
from typing import NamedTuple, TypeVar
from xml.etree.ElementTree import Element

from cadenza.errors import CadenzaError
from cadenza.music.formats.musicxml.marks import Move
from cadenza.music.formats.musicxml.notes import SheetNote
from cadenza.music.formats.musicxml.timeline import ZERO, Placed, number, numbers_in
from cadenza.music.score import BEAT_TYPES, MAX_SIGNS, PITCHES, key_above
from cadenza.music.signs.notes import SignedNote
from cadenza.music.signs.tempo_map import Swing

_COUNTED = re.compile("[0-9]{1,6}(?![0-9])")
"""What a bar is counted as, such as 4a; X1 is none, and part of the bar before it."""
_MAX_TIMES = 999  # times that a section is played, by the numbers of endings
_MAX_BEATS = 64  # beats of a bar; a longer one has no metre


@dataclass(slots=True)
class Signs:
    """The signs of a bar that say in which order bars are played.

    A repeat, segno and coda stand where the bar begins; the others take effect where it ends.
    """

    begins_repeat: bool = False
    times: int = 1
    """The number of times that a section is played whose repeat sign is here; 1 without one."""
    after_jump: bool = False
    """Whether that repeat is taken again after a jump back."""
    ending: frozenset[int] = frozenset()
    """The passes through its section on which the bar is played; empty for all."""
    segno: str | None = None
    coda: str | None = None
    dal_segno: str | None = None
    to_coda: str | None = None
    da_capo: bool = False
    fine: bool = False
    returns_on: frozenset[int] = frozenset()
    """The times that the bar is played at which the player goes back from it; empty for once, after
    the repeats of its section."""
    to_coda_on: frozenset[int] = frozenset()
    """The times at which the player goes to the coda; empty for the first after a jump back."""

    @property
    def returns(self) -> bool:
        """Whether the player goes back from here."""
        return self.da_capo or self.dal_segno is not None


@dataclass(slots=True)
class WrittenBar:
    """A measure, or the part of one up to or from a repeat sign within it, in quarters.

    A beat is `1 / beat_type` of a whole note. At a fine within the bar, the music ends at `cut`.
    `key` is the number of sharps at concert pitch, negative for flats, if known.
    """

    measure: int
    begin: Fraction
    end: Fraction
    number: int
    beat_type: int
    signs: Signs = field(default_factory=Signs)
    cut: Fraction | None = None
    key: int | None = None

    @property
    def beats(self) -> list[Fraction]:
        """The times at which beats begin; the first is `begin`, and there are none of very many."""
        count = max(1, round((self.end - self.begin) * self.beat_type / 4))
        if count > _MAX_BEATS:
            return []
        return [self.begin + Fraction(4 * beat, self.beat_type) for beat in range(count)]


def bars_of(part: Sequence[Placed], begins: Sequence[Fraction]) -> list[WrittenBar]:
    """The bars of a part, with its repeats and endings; `begins` as `timeline` returns it."""
    reader = _BarReader(begins)
    for placed in part:
        reader.read(placed)
    for bar in reader.bars:
        bar.beat_type = _filling(bar.end - bar.begin, bar.beat_type)
    return reader.bars


def bar_at(bars: Sequence[WrittenBar], measure: int, quarter: Fraction) -> int:
    """The index of the bar that is the measure, or the part of it, at a time."""
    at = bisect_right(bars, (measure, quarter), key=lambda bar: (bar.measure, bar.begin))
    return max(at - 1, 0)


class _BarReader:
    def __init__(self, begins: Sequence[Fraction]) -> None:
        self.bars: list[WrittenBar] = []
        self._begins = begins
        self._bracket: frozenset[int] = frozenset()  # of the ending that goes on
        self._is_repeat_next = False
        self._beat_type = 4
        self._written_key: int | None = None
        self._semitones = 0  # that the part sounds above what is written

    def read(self, placed: Placed) -> None:
        measure, element = placed.measure, placed.element
        if element.tag == "measure":
            self._begin(measure, self._begins[measure], element.get("number", ""))
            self.bars[-1].signs.begins_repeat = self._is_repeat_next
            self._is_repeat_next = False
        elif element.tag == "attributes":
            beat_type = int(number(element.findtext("time/beat-type")))
            self._beat_type = beat_type if beat_type in BEAT_TYPES else self._beat_type
            self.bars[-1].beat_type = self._beat_type
            self._read_key(element)
            if placed.quarter <= self.bars[-1].begin:
                self.bars[-1].key = self._key
        elif element.tag == "barline":
            self._read_barline(element, placed.quarter)

    def _begin(self, measure: int, quarter: Fraction, printed: str) -> None:
        digits = _COUNTED.match(printed)
        previous_number = self.bars[-1].number if self.bars else 1
        bar_number = int(digits[0]) if digits else previous_number if printed else measure + 1
        end, signs = self._begins[measure + 1], Signs(ending=self._bracket)
        self.bars.append(
            WrittenBar(measure, quarter, end, bar_number, self._beat_type, signs, key=self._key)
        )

    def _read_key(self, attributes: Element) -> None:
        """Read a key signature, and how the instrument transposes."""
        if (transpose := attributes.find("transpose")) is not None:
            self._semitones = int(number(transpose.findtext("chromatic")))
        if (fifths := attributes.findtext("key/fifths")) is not None:
            self._written_key = int(number(fifths))

    @property
    def _key(self) -> int | None:
        """The key signature at concert pitch, if there is a usual one."""
        if self._written_key is None or abs(self._written_key) > MAX_SIGNS:
            return None
        return key_above(self._written_key, self._semitones)

    def _read_barline(self, barline: Element, quarter: Fraction) -> None:
        """Read a repeat and an ending; within a measure, a repeat begins a new bar."""
        bar = self.bars[-1]
        location = barline.get("location", "right")
        repeat, ending = barline.find("repeat"), barline.find("ending")
        if ending is not None and (ending.get("type") == "start" or not self._bracket):
            passes = numbers_in(ending.get("number", "")) or numbers_in(ending.text or "")
            if ending.get("type") != "start" and repeat is not None:
                passes |= {1}  # of a bracket without a beginning, whatever its number
            bar.signs.ending = self._bracket = passes
        if ending is not None and ending.get("type") != "start":
            self._bracket = frozenset()
        if repeat is None:
            return
        direction = repeat.get("direction")
        if direction == "backward":
            repeated = self.bars[-2 if location == "left" and len(self.bars) > 1 else -1].signs
            repeated.times = min(max(2, int(number(repeat.get("times")))), _MAX_TIMES)
            repeated.after_jump = repeat.get("after-jump") == "yes"
        if direction and location == "middle" and quarter > bar.begin:
            self._begin(bar.measure, quarter, str(bar.number))
            bar.end = quarter
        if direction == "forward":
            self._is_repeat_next = location == "right"
            self.bars[-1].signs.begins_repeat |= location != "right"
            if ending is None:
                self.bars[-1].signs.ending = self._bracket = frozenset()


def _filling(quarters: Fraction, beat_type: int) -> int:
    """The type of beat of a bar: `beat_type`, or a finer one where that does not fill it."""
    finer = (each for each in sorted(BEAT_TYPES) if each >= beat_type)
    return next((each for each in finer if (quarters * each / 4).denominator == 1), beat_type)


def played_order(bars: Sequence[Signs]) -> Iterator[tuple[int, int]]:
    """Yield bars from 0 as they are played, and the passes through their sections, from 1.

    A jump is taken once, on the last pass through its bar, unless it says when. From where it leads
    to up to the bar where it stood, repeats are not taken again, unless they say so; the first sign
    to the coda leads there, and a fine to what follows the jump, which is another movement, if
    anything. A sign whose goal is missing has no effect, see `without_goal`.
    """
    goals, sections = _Goals(bars), _sections(bars)
    at, turn = 0, 1  # the bar, and the number of the pass through its section
    first, returned = 0, -1  # bar of the movement; bar from which the latest jump led back, if any
    goes_to_coda = False  # whether a sign to the coda is followed
    jumped = set[int]()  # bars whose jump back was taken
    counts = Counter[int]()  # how often bars were played
    while at < len(bars):
        signs = bars[at]
        section = sections[bisect_right(sections, at, key=lambda each: each.begin) - 1]
        if at <= returned and not section.after_jump:
            turn = section.turns
        if not signs.ending or turn in signs.ending:
            yield at, turn
            is_last = turn == max(signs.ending, default=section.turns)
            if is_last and signs.fine and returned >= 0:
                if at > returned:
                    return
                at = first = returned + 1
                turn, returned, goes_to_coda = 1, -1, False
                continue
            counts[at] += 1
            goal = None
            if _is_on(signs.to_coda_on, counts[at], is_last and goes_to_coda):
                goal = goals.of_coda(at)
                goes_to_coda &= goal is None
            is_next = is_last and at not in jumped
            if goal is None and _is_on(signs.returns_on, counts[at], is_next):
                jumped.add(at)
                goal = goals.of_return(at, first)
                if goal is not None:
                    returned, goes_to_coda = at, True
            if goal is not None:
                at, turn = goal, 1
                continue
            bracket_ends = signs.ending and (
                at + 1 == section.end or bars[at + 1].ending != signs.ending
            )
            if turn < section.turns and (signs.times > 1 or bracket_ends):
                at, turn = section.begin, turn + 1
                continue
        at += 1
        turn = 1 if at == section.end else turn


def _is_on(times: frozenset[int], time: int, otherwise: bool) -> bool:
    """Whether something is done at a time: one of the `times`, if it says any."""
    return time in times if times else otherwise


def without_goal(bars: Sequence[Signs]) -> int:
    """The number of signs that send the player to a segno or a coda that is not there."""
    goals = _Goals(bars)
    return sum(
        (signs.dal_segno is not None and goals.of_return(at) is None)
        + (signs.to_coda is not None and goals.of_coda(at) is None)
        for at, signs in enumerate(bars)
    )


class _Goals:
    """The goals of jumps. A sign whose label no goal has leads to the nearest goal of its kind."""

    def __init__(self, bars: Sequence[Signs]) -> None:
        self._bars = bars
        self._segnos: defaultdict[str | None, list[int]] = defaultdict(list)
        self._codas: defaultdict[str | None, list[int]] = defaultdict(list)
        for at, signs in enumerate(bars):
            for goals, label in ((self._segnos, signs.segno), (self._codas, signs.coda)):
                if label is not None:
                    goals[label].append(at)
                    goals[None].append(at)

    def of_return(self, at: int, first: int = 0) -> int | None:
        """The goal of a da capo or dal segno: the `first` bar, or the nearest segno before."""
        signs = self._bars[at]
        if signs.dal_segno is not None:
            for label in (signs.dal_segno, None):
                if before := bisect_right(self._segnos[label], at):
                    return self._segnos[label][before - 1]
        return first if signs.da_capo else None

    def of_coda(self, at: int) -> int | None:
        """The nearest coda after a bar."""
        signs = self._bars[at]
        if signs.to_coda is not None:
            for label in (signs.to_coda, None):
                before = bisect_left(self._codas[label], at + 1)
                if before < len(self._codas[label]):
                    return self._codas[label][before]
        return None


class _Section(NamedTuple):
    """A section that is repeated as a whole: first bar, bar after the last, and passes."""

    begin: int
    end: int
    turns: int
    after_jump: bool


def _sections(bars: Sequence[Signs]) -> list[_Section]:
    """All sections. One begins at a repeat sign, or after the repeats of the one before."""
    begins = [0] if bars else []
    for at, (before, signs) in enumerate(pairwise(bars), start=1):
        ended = before.ending or before.times > 1 or before.returns
        if signs.begins_repeat or (ended and not signs.ending):
            begins.append(at)
    return [
        _Section(
            begin,
            end,
            max(max(signs.times, *signs.ending, 1) for signs in bars[begin:end]),
            any(signs.after_jump for signs in bars[begin:end]),
        )
        for begin, end in pairwise([*begins, len(bars)])
    ]


_T = TypeVar("_T")
_MAX = 100_000  # notes or bars, with repeats


@dataclass(frozen=True, slots=True)
class Passage:
    """A bar, by its index, as it is played on a pass through its section.

    It is `later` quarters later than on the sheet, and `jumps` is whether the bar before it on
    the sheet is not the one that was played before. Where it `is_fine`, the music ends in it.
    """

    index: int
    bar: WrittenBar
    turn: int
    later: Fraction
    jumps: bool
    is_fine: bool = False

    def cut(self, note: SignedNote) -> SignedNote | None:
        """A note of the bar as it is played in this passage, up to a fine; None if after it."""
        end = self.bar.cut if self.is_fine else None
        if end is not None and note.onset >= end:
            return None
        length = note.duration if end is None else min(note.duration, end - note.onset)
        return replace(note, onset=note.onset + self.later, duration=length)


class Unrolled:
    """A sheet whose bars are played in the order of their signs: `passages`.

    Raises CadenzaError if it or a method would play too many bars, notes or marks.
    """

    def __init__(self, bars: Sequence[WrittenBar]) -> None:
        self._bars = bars
        self.passages: list[Passage] = []
        begin, previous = ZERO, -1
        for index, turn in islice(played_order([bar.signs for bar in bars]), _MAX + 1):
            bar = bars[index]
            self.passages.append(
                Passage(index, bar, turn, begin - bar.begin, index != previous + 1)
            )
            begin, previous = begin + bar.end - bar.begin, index
        _check(len(self.passages), "bars")
        for at, (passage, following) in enumerate(pairwise([*self.passages, None])):
            assert passage is not None
            # A repeat leads back, but a fine to the end or to another movement.
            if following is None or (following.jumps and following.index > passage.index):
                self.passages[at] = replace(passage, is_fine=passage.bar.signs.fine)

    def sections(self) -> list[tuple[Fraction, Fraction]]:
        """The sections in the order in which they are played: begin and end on the sheet."""
        sections: list[tuple[Fraction, Fraction]] = []
        for passage in self.passages:
            begin = passage.bar.begin if passage.jumps or not sections else sections.pop()[0]
            sections.append((begin, passage.bar.end))
        return sections

    def notes(self, sheet_notes: Iterable[SheetNote], counts: Counter[str]) -> list[SignedNote]:
        """The notes of a part as they are played; tied notes are one, with the signs of all.

        Those that no key plays are left out, and added to `counts`.
        """
        by_bar: defaultdict[int, list[SheetNote]] = defaultdict(list)
        for note in sheet_notes:
            by_bar[bar_at(self._bars, note.measure, note.signed.onset)].append(note)
        notes: list[SignedNote] = []
        # Notes that ties lead on from, and in which passages, by pitch and end.
        tied: dict[tuple[int, Fraction], tuple[int, Passage]] = {}
        for passage in self.passages:
            for note in by_bar.get(passage.index, ()):
                if note.passes and passage.turn not in note.passes:
                    continue
                if note.signed.pitch not in PITCHES:
                    counts["outside"] += not note.tied
                    continue
                signed = passage.cut(note.signed)
                if signed is None:
                    continue
                at, tied_passage = tied.get((signed.pitch, signed.onset), (-1, passage))
                # Whether the next bar on the sheet follows.
                goes_on = tied_passage is passage or not passage.jumps
                is_led_to = at >= 0 and (note.tied or (goes_on and notes[at].voice == signed.voice))
                if is_led_to and not _is_struck(signed, notes[at]):
                    notes[at] = _joined(notes[at], signed)
                else:
                    at = len(notes)
                    notes.append(signed)
                if note.ties:
                    tied[signed.pitch, notes[at].end] = at, passage
            _check(len(notes), "notes")
        return notes

    def pedal(self, moves: Iterable[Move]) -> list[tuple[Fraction, int]]:
        """The places [quarters] and values of the pedal of a part; after a jump, as it is there."""
        marks = [(bar_at(self._bars, move.measure, move.quarter), move) for move in moves]
        played: list[tuple[Fraction, int]] = []
        for passage, move, is_before in self._marks(marks):
            value = move.value if move else 0
            if not is_before and move:
                played.append((move.quarter + passage.later, value))
            elif value != (played[-1][1] if played else 0):
                played.append((passage.bar.begin + passage.later, value))
            _check(len(played), "moves of the pedal")
        return played

    def swings(self, swings: Iterable[Swing]) -> list[Swing]:
        """Where notes swing as they are played; after a jump, as they do there."""
        begins = [bar.begin for bar in self._bars]
        ordered = sorted(swings, key=attrgetter("onset"))
        marks = [(max(bisect_right(begins, swing.onset) - 1, 0), swing) for swing in ordered]
        played: list[Swing] = []
        for passage, swing, is_before in self._marks(marks):
            swing = swing or Swing(ZERO, first=1, second=1)
            onset = (passage.bar.begin if is_before else swing.onset) + passage.later
            played.append(replace(swing, onset=onset, beat=swing.beat + passage.later))
            _check(len(played), "changes of swing")
        return played

    def _marks(self, marks: Sequence[tuple[int, _T]]) -> Iterator[tuple[Passage, _T | None, bool]]:
        """Yield marks, given with their bars, with the passages in which they are played.

        At a jump comes first the mark before the bar, None without one. The last item says whether
        it is that.
        """
        for passage in self.passages if marks else ():
            first, beyond = (
                bisect_left(marks, bar, key=itemgetter(0))
                for bar in (passage.index, passage.index + 1)
            )
            if passage.jumps:
                yield passage, marks[first - 1][1] if first else None, True
            for _, mark in marks[first:beyond]:
                yield passage, mark, False


def _is_struck(note: SignedNote, previous: SignedNote) -> bool:
    """Whether a note is struck, although a tie leads to it from the one before, for its signs."""
    if previous.grace:
        return False
    kinds = [each.ornament and each.ornament.kind for each in (previous, note)]
    is_new_ornament = kinds[1] is not None and kinds[0] is not kinds[1]
    return is_new_ornament or (note.tremolo is not None and previous.tremolo is None)


def _joined(note: SignedNote, following: SignedNote) -> SignedNote:
    """Two tied notes as one. A grace note is left out, as what it is tied to sounds there."""
    if note.grace:
        return following
    return replace(
        note,
        duration=following.end - note.onset,
        marks=note.marks | following.marks,
        slurs=note.slurs + following.slurs,
        ornament=note.ornament or following.ornament,
        tremolo=note.tremolo or following.tremolo,
        release=following.release,
    )


def _check(number: int, noun: str) -> None:
    if number > _MAX:
        raise CadenzaError(f"over {_MAX} {noun} with all repeats, too many")
