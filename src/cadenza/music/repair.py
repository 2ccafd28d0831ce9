"""Repairs of the notes of a file, so that one piano can play them, and remarks on the repairs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from cadenza.errors import CadenzaError
from cadenza.fingers import Finger
from cadenza.music.score import Note


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
    found: list[RawNote],
    counts: Counter[str],
    remarks: Iterable[str],
    seconds: Callable[[float], float] = float,
) -> tuple[tuple[Note, ...], tuple[str, ...]]:
    """The notes of a file that one piano can play, and remarks on what was repaired.

    Args:
        found: all notes of the file, in its unit of time.
        counts: the numbers of notes that were repaired before, by the names in `_remarks`.
        remarks: remarks that were made before.
        seconds: converts times of the file to seconds [s].

    Raises:
        CadenzaError: there are no notes.
    """
    notes = tuple(
        Note(
            seconds(note.start),
            seconds(note.end),
            note.pitch,
            note.velocity,
            note.finger,
            note.tracks,
            note.hands,
        )
        for note in _without_overlaps(found, counts)
    )
    remarks = (*remarks, *_remarks(counts))
    if not notes:
        why = f" left ({'; '.join(remarks)})" if remarks else ""
        raise CadenzaError(f"there are no notes{why}; choose another file")
    return notes, remarks


def _without_overlaps(found: list[RawNote], counts: Counter[str]) -> list[RawNote]:
    """The notes that last, at most one of each pitch at a time.

    One that is struck again while it is held ends there, and the other lasts as long as both. The
    number of each kind of repair is added to `counts`.
    """
    together: dict[tuple[float, int], list[RawNote]] = {}
    for note in sorted(found, key=lambda note: note.start):
        if note.end > note.start:
            together.setdefault((note.start, note.pitch), []).append(note)
    lasting = sum(map(len, together.values()))
    counts["zero"] = len(found) - lasting
    counts["doubled"] += lasting - len(together)
    played: list[RawNote] = []
    latest: dict[int, RawNote] = {}
    for doubles in together.values():
        note = _merged(doubles)
        before = latest.get(note.pitch)
        latest[note.pitch] = note
        played.append(note)
        if before and before.end > note.start:
            counts["cut"] += 1
            if before.released and note.released:  # the key is held as long as the longer one
                note.end = max(before.end, note.end)
            before.release(note.start)
    counts["unreleased"] = sum(not note.released for note in played)
    return played


def _merged(notes: Sequence[RawNote]) -> RawNote:
    """The note with the largest velocity and the latest end of all; a known end counts first."""
    first, *others = notes
    if not others:  # as hardly ever any are
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


def counted_remarks(cases: Iterable[tuple[int, str, str]]) -> list[str]:
    """Remarks such as "2 notes left out" from counts, nouns and what was done; none for 0."""
    return [
        f"{count} {what if count == 1 else what + 's'} {done}"
        for count, what, done in cases
        if count
    ]


def _remarks(counts: Counter[str]) -> list[str]:
    """Remarks on repairs, in plain words."""
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
    return counted_remarks((counts[what], "note", done) for what, done in repairs.items())
