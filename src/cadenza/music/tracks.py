"""The tracks of a file, of which those to be played can be chosen."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from cadenza.errors import CadenzaError


@dataclass(frozen=True, slots=True)
class Track:
    """The notes of one instrument in a file: how many, from the `lowest` to the `highest` pitch.

    `number` counts the tracks with notes from 1; `channel` is that of MIDI, 1 to 16, None
    where the file is not MIDI.
    """

    number: int
    name: str
    instrument: str
    channel: int | None
    notes: int
    lowest: int
    highest: int


def check_chosen(chosen: Collection[int], tracks: Sequence[Track], path: Path) -> None:
    """Raises:
    CadenzaError: one of the numbers `chosen` is that of none of the `tracks`.
    """
    if missing := sorted(set(chosen) - {track.number for track in tracks}):
        there = f"tracks 1 to {len(tracks)}" if len(tracks) > 1 else "one track"
        raise CadenzaError(f"{path}: there is no track {missing[0]}; the file has {there}")
