"""How much of a song is left in an arrangement of it."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cadenza.arranging.moments import TOGETHER, Source
from cadenza.arranging.reduction import Struck
from cadenza.music.score import OCTAVE, Note, Score


@dataclass(frozen=True)
class Fidelity:
    """How much of a song is left in an arrangement."""

    melody_kept: float
    """Share of the notes of the melody that are played."""
    bass_kept: float
    """Share of the notes of the bass that are played, in any octave."""
    others_kept: float
    """Share of all other notes that are played, in any octave; notes in unison count once."""
    pitch_classes_kept: float
    """Share of the pitch classes of each beat that sound in it."""
    notes_moved: int
    """Number of notes that are played in another octave."""
    notes_added: int
    """Number of notes that are struck again while they sound."""

    def __str__(self) -> str:
        """What was done, in words."""
        melody, bass = _in_words(self.melody_kept), _in_words(self.bass_kept)
        said = f"{melody} of the melody, {bass} of the bass"
        if self.melody_kept == self.bass_kept == 1:
            said = "melody and bass whole"
        said += f", {self.others_kept:.0%} of the other notes"
        if self.notes_moved:
            said += f", {self.notes_moved} moved by octaves"
        if self.notes_added:
            said += f", {self.notes_added} struck again"
        return said


NOTHING_LOST = Fidelity(1.0, 1.0, 1.0, 1.0, 0, 0)


def _in_words(share: float) -> str:
    return "all" if share == 1 else f"{int(1000 * share) / 1000:.1%}"  # never 100 %


def fidelity_of(
    song: Sequence[Source], struck: Iterable[Struck], arranged: Score, beats: Sequence[float]
) -> Fidelity:
    """Compares an arrangement with the song.

    Args:
        song: all notes of the song.
        struck: the notes of the arrangement, as they are struck.
        arranged: the score of these.
        beats: when beats begin [s].
    """
    struck = list(struck)
    kept = {each.source for each in struck}
    sounding, played = _pitch_classes(song, beats), _pitch_classes(arranged.notes, beats)
    return Fidelity(
        melody_kept=_share([note for note in song if note.melody], kept),
        bass_kept=_share([note for note in song if note.bass], kept),
        others_kept=_share([note for note in song if not note.melody and not note.bass], kept),
        pitch_classes_kept=float((sounding & played).sum() / max(sounding.sum(), 1)),
        notes_moved=sum(each.pitch != each.source.pitch for each in struck),
        notes_added=sum(each.source.added for each in struck),
    )


def _share(notes: Sequence[Source], kept: set[Source]) -> float:
    return sum(note in kept for note in notes) / len(notes) if notes else 1.0


def _pitch_classes(
    notes: Iterable[Source] | Iterable[Note], beats: Sequence[float]
) -> NDArray[np.bool_]:
    """(B, 12) the pitch classes that sound in each beat."""
    table = np.zeros((len(beats), OCTAVE), bool)
    for note in notes:
        first = max(bisect_right(beats, note.start + TOGETHER) - 1, 0)
        end = max(bisect_right(beats, note.end - TOGETHER), first + 1)
        table[first:end, note.pitch % OCTAVE] = True
    return table
