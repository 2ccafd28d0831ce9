"""A sheet as it is played, bar after bar, with its repeats and jumps."""

from bisect import bisect_left, bisect_right
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import islice, pairwise
from operator import attrgetter, itemgetter
from typing import TypeVar

from cadenza.errors import CadenzaError
from cadenza.music.formats.musicxml.bars import WrittenBar, bar_at, played_order
from cadenza.music.formats.musicxml.dynamics import Move
from cadenza.music.formats.musicxml.notes import SheetNote
from cadenza.music.formats.musicxml.timeline import ZERO
from cadenza.music.score import PITCHES
from cadenza.music.signs.notes import SignedNote
from cadenza.music.signs.tempo_map import Swing

_T = TypeVar("_T")
_MAX = 100_000  # notes or bars, with repeats


@dataclass(frozen=True, slots=True)
class Passage:
    """A bar, by its index, as it is played on a pass through its section.

    It is `later` by so many quarters than on the sheet, and `jumps` is whether the bar before it on
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
        now, before = ZERO, -1
        for index, turn in islice(played_order([bar.signs for bar in bars]), _MAX + 1):
            bar = bars[index]
            self.passages.append(Passage(index, bar, turn, now - bar.begin, index != before + 1))
            now, before = now + bar.end - bar.begin, index
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

    def notes(self, written: Iterable[SheetNote], counts: Counter[str]) -> list[SignedNote]:
        """The notes of a part as they are played; tied notes are one, with the signs of all.

        Those that no key plays are left out, and added to `counts`.
        """
        by_bar: defaultdict[int, list[SheetNote]] = defaultdict(list)
        for note in written:
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
                now = passage.cut(note.signed)
                if now is None:
                    continue
                at, begun = tied.get((now.pitch, now.onset), (-1, passage))
                goes_on = begun is passage or not passage.jumps  # to what follows on the sheet
                is_led_to = at >= 0 and (note.tied or (goes_on and notes[at].voice == now.voice))
                if is_led_to and not _is_struck(now, notes[at]):
                    notes[at] = _joined(notes[at], now)
                else:
                    at = len(notes)
                    notes.append(now)
                if note.ties:
                    tied[now.pitch, notes[at].end] = at, passage
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


def _is_struck(note: SignedNote, before: SignedNote) -> bool:
    """Whether a note is struck, although a tie leads to it from the one before, for its signs."""
    if before.grace:
        return False
    kinds = [each.ornament and each.ornament.kind for each in (before, note)]
    is_new_ornament = kinds[1] is not None and kinds[0] is not kinds[1]
    return is_new_ornament or (note.tremolo is not None and before.tremolo is None)


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


def _check(number: int, what: str) -> None:
    if number > _MAX:
        raise CadenzaError(f"over {_MAX} {what} with all repeats, too many")
