"""Repairs of the notes of a file, so that one piano can play them, and remarks on the repairs."""

from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter
from typing import TypeVar

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.score import Note

_Time = TypeVar("_Time")
_PEDAL_DOWN = 127  # the value of a pedal that is all the way down


@dataclass(slots=True)
class RawNote:
    """A note as found in a file, with times in the unit of the file."""

    start: float
    end: float
    pitch: int
    velocity: int
    released: bool = False
    finger: Finger | None = None
    tracks: tuple[int, ...] = ()
    hands: tuple[int, ...] = ()

    def release(self, time: float) -> None:
        """End the note."""
        self.end, self.released = time, True


def repaired_notes(
    raw_notes: list[RawNote],
    counts: Counter[str],
    remarks: Iterable[str],
    seconds: Callable[[float], float] = float,
) -> tuple[tuple[Note, ...], tuple[str, ...]]:
    """The notes of a file that one piano can play, and remarks on what was repaired.

    Raises CadenzaError if there are no notes.

    Args:
        raw_notes: all notes of the file, in its unit of time.
        counts: the numbers of earlier repairs, by the names in `_remarks`.
        remarks: earlier remarks.
        seconds: converts times of the file to seconds [s].
    """
    notes = tuple(
        Note(seconds(n.start), seconds(n.end), n.pitch, n.velocity, n.finger, n.tracks, n.hands)
        for n in _without_overlaps(raw_notes, counts)
    )
    remarks = (*remarks, *_remarks(counts))
    if not notes:
        why = f" left ({'; '.join(remarks)})" if remarks else ""
        raise CadenzaError(f"there are no notes{why}; choose another file")
    return notes, remarks


def _without_overlaps(notes: list[RawNote], counts: Counter[str]) -> list[RawNote]:
    """The notes with a length, at most one of each pitch at a time.

    A note ends at the next onset of its pitch, and the second note lasts as long as both. The
    number of each kind of repair is added to `counts`.
    """
    doubles_at: dict[tuple[float, int], list[RawNote]] = {}
    for note in sorted(notes, key=lambda note: note.start):
        if note.end > note.start:
            doubles_at.setdefault((note.start, note.pitch), []).append(note)
    num_notes = sum(map(len, doubles_at.values()))
    counts["zero"] = len(notes) - num_notes
    counts["doubled"] += num_notes - len(doubles_at)
    repaired: list[RawNote] = []
    latest: dict[int, RawNote] = {}
    for doubles in doubles_at.values():
        note = _merged(doubles)
        previous = latest.get(note.pitch)
        latest[note.pitch] = note
        repaired.append(note)
        if previous and previous.end > note.start:
            counts["cut"] += 1
            if previous.released and note.released:  # the key is held as long as the longer one
                note.end = max(previous.end, note.end)
            previous.release(note.start)
    counts["unreleased"] = sum(not note.released for note in repaired)
    return repaired


def _merged(notes: Sequence[RawNote]) -> RawNote:
    """The note with the largest velocity and the latest end of all; a known end counts first."""
    first, *others = notes
    if not others:  # the usual case
        return replace(first)
    is_known = any(note.released for note in notes)
    return replace(
        first,
        end=max(note.end for note in notes if note.released == is_known),
        velocity=max(note.velocity for note in notes),
        released=is_known,
        finger=next((note.finger for note in notes if note.finger), None),
        tracks=tuple(dict.fromkeys(track for note in notes for track in note.tracks)),
        hands=tuple(sorted({hand for note in notes for hand in note.hands})),
    )


def merged_pedal(moves: Iterable[tuple[_Time, Hashable, int]]) -> Iterator[tuple[_Time, int]]:
    """Yield times and values of the one pedal of a piano: the lowest that any channel holds it.

    `moves` are times, channels or parts of a sheet, and values, in order of time. Where several
    channels change the pedal at one time, it goes up before it goes down again.
    """
    values: dict[Hashable, int] = {}
    channels_at = [0] * (_PEDAL_DOWN + 1)  # how many hold the pedal at each value

    def lowest_after(changes: Iterable[tuple[Hashable, int]]) -> int:
        for channel, value in changes:
            if channel in values:
                channels_at[values[channel]] -= 1
            values[channel] = value
            channels_at[value] += 1
        return next(value for value in range(_PEDAL_DOWN, -1, -1) if channels_at[value])

    latest = 0
    for time, together in groupby(moves, key=itemgetter(0)):
        changes = [(channel, value) for _, channel, value in together]
        between = lowest_after(sorted(changes, key=itemgetter(1), reverse=True))
        after = lowest_after(changes)
        is_alone = len(values) == 1  # no other has one
        for value in [value for _, value in changes] if is_alone else (between, after):
            if is_alone or value != latest:
                yield time, value
            latest = value


def counted_remarks(cases: Iterable[tuple[int, str, str]]) -> list[str]:
    """Remarks such as "2 notes left out" from counts, nouns and repairs; none for 0."""
    return [
        f"{count} {noun if count == 1 else noun + 's'} {action}"
        for count, noun, action in cases
        if count
    ]


def _remarks(counts: Counter[str]) -> list[str]:
    repairs = {
        "drums": "of drums left out",
        "muted": "in a channel of no volume left out",
        "bent": "bent by the pitch wheel taken for the nearest key",
        "outside": "outside the piano's 88 keys left out",
        "zero": "of no length left out",
        "doubled": "doubled at the same moment merged",
        "cut": "cut short where the same key is struck again",
        "unreleased": "never released: held to the end of the track",
    }
    return counted_remarks((counts[kind], "note", action) for kind, action in repairs.items())
