"""The hands that play the notes of a part on two staves."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import groupby

from cadenza.music.formats.musicxml.timeline import MAX_STAVES, ZERO, Placed, number

_STAVES = 2  # of a part for both hands: the upper one is for the right hand


@dataclass(slots=True)
class _Run:
    """Notes that follow each other in a voice of a bar, and the staff where they begin."""

    voice: str
    staff: int
    indices: list[int] = field(default_factory=list)
    end: Fraction = ZERO
    sounds: bool = False


def hands_of(part: Sequence[Placed], others: Sequence[bool]) -> list[int | None]:
    """The hands that play the notes and rests of a part, in their order; None where nobody knows.

    The upper staff is the right hand's. A voice that goes to the other staff stays with the hand of
    the staff where it began, unless in a bar it begins on the other while others are on its own.

    Args:
        part: its elements.
        others: which of its notes and rests are on a staff that is not played, such as an ossia.
    """
    notes = [placed for placed in part if placed.element.tag == "note"]
    played = [(i, note) for i, note in enumerate(notes) if not others[i]]
    staves = {note.staff or 1 for _, note in played}
    if len(staves) < _STAVES:
        declared = max(number(placed.element.findtext("staves")) for placed in part)
        silent = {note.staff or 1 for note in notes} - staves
        staves |= {*range(1, min(int(declared), MAX_STAVES) + 1)} - silent
    hands: list[int | None] = [None] * len(notes)
    if len(staves) != _STAVES:
        return hands
    home: dict[str, int] = {}  # the staff on which a voice began
    for _, bar in groupby(played, key=lambda each: each[1].measure):
        runs = _runs(bar)
        busy = {run.staff for run in runs if run.sounds}
        for run in runs:
            own = home.setdefault(run.voice, run.staff)
            hand = int((run.staff if own in busy else own) == max(staves))
            for index in run.indices:
                hands[index] = hand
    return hands


def _runs(bar: Iterable[tuple[int, Placed]]) -> list[_Run]:
    """The runs of a bar, whose notes come with their indices."""
    runs: list[_Run] = []
    going: dict[str, _Run] = {}
    for index, placed in bar:
        staff = placed.staff or 1
        run = going.get(placed.voice)
        is_chord = placed.element.find("chord") is not None
        if run is None or (placed.quarter < run.end and not is_chord):
            run = going[placed.voice] = _Run(placed.voice, staff)
            runs.append(run)
        run.indices.append(index)
        run.end = run.end if is_chord else placed.quarter + placed.duration
        run.sounds |= placed.element.find("rest") is None
    return runs
