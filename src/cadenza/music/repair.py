"""Repairs of the notes of a file, so that one piano can play them; and their remarks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

from cadenza.fingers import Finger


@dataclass(slots=True)
class RawNote:
    """A note as found in a file; equal times are exactly equal, in whatever unit."""

    start: float
    end: float
    pitch: int
    velocity: int
    released: bool = False
    finger: Finger | None = None


def repaired(found: list[RawNote], counts: Counter[str]) -> list[RawNote]:
    """The notes without those of length zero, at most one of a pitch at a time.

    `counts` gets the number of each kind of repair.
    """
    lasting = [note for note in found if note.end > note.start]
    counts["zero"] = len(found) - len(lasting)
    played: list[RawNote] = []
    latest: dict[int, RawNote] = {}
    for note in sorted(lasting, key=lambda note: note.start):
        before = latest.get(note.pitch)
        if before and before.start == note.start:
            counts["doubled"] += 1
            _merge(before, note)
            continue
        if before and before.end > note.start:
            counts["cut"] += 1
            before.end, before.released = note.start, True
        latest[note.pitch] = replace(note)
        played.append(latest[note.pitch])
    counts["unreleased"] = sum(not note.released for note in played)
    return played


def _merge(note: RawNote, other: RawNote) -> None:
    """Makes `note` as loud as the louder and as long as the longer; a known end beats none."""
    note.velocity = max(note.velocity, other.velocity)
    note.finger = note.finger or other.finger
    if note.released == other.released:
        note.end = max(note.end, other.end)
    elif other.released:
        note.end, note.released = other.end, True


def counted_remarks(cases: Iterable[tuple[int, str, str]]) -> list[str]:
    """Remarks on (count, what, what was done), for counts that are not zero."""
    return [f"{count} {what}{'s'[: count != 1]} {done}" for count, what, done in cases if count]


def repair_remarks(counts: Counter[str]) -> list[str]:
    """Remarks on what was changed, in plain words."""
    repairs = {
        "drums": "on the drum channel (10) left out",
        "outside": "outside the piano's 88 keys left out",
        "zero": "of no length left out",
        "doubled": "doubled at the same moment merged",
        "cut": "cut short where the same key is struck again",
        "unreleased": "never released: held to the end of the track",
    }
    return counted_remarks((counts[what], "note", done) for what, done in repairs.items())
