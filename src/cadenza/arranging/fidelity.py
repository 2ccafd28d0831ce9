"""The fidelity of an arrangement to its song."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.arranging.parts import TOGETHER, SourceNote
from cadenza.arranging.reduction import Struck
from cadenza.music.score import OCTAVE, Note, Score


class Fate(NamedTuple):
    """The fate of a note of a song in an arrangement of it."""

    # The note as written; if it is struck again while it sounds, from then on
    note: SourceNote
    played: int | None  # the pitch at which it is played; None if it is left out

    @property
    def as_json(self) -> dict[str, Any]:
        """The entry of `arrangement.json`, which pages show."""
        note = self.note
        part = "melody" if note.melody else "bass" if note.bass else "harmony"
        times = {"start": round(note.start, 4), "end": round(note.end, 4)}
        return {**times, "pitch": note.pitch, "played": self.played, "part": part} | (
            {"again": True} if note.added else {}
        )


@dataclass(frozen=True)
class Fidelity:
    """The parts of a song that are left in an arrangement."""

    melody_kept: float  # share of the notes of the melody that are played
    bass_kept: float  # share of the notes of the bass that are played, in any octave
    # Share of all other notes that are played, in any octave, as written or later in the beat;
    # notes in unison count once
    others_kept: float
    pitch_classes_kept: float  # share of the pitch classes of each beat that sound in it
    notes_moved: int  # number of notes that are played in another octave
    notes_added: int  # number of notes that are struck again while they sound

    def __str__(self) -> str:
        changed = self.notes_moved or self.notes_added
        if self.melody_kept == self.bass_kept == self.others_kept == 1 and not changed:
            return "all notes kept"
        melody, bass = _in_words(self.melody_kept), _in_words(self.bass_kept)
        summary = f"{melody} of the melody, {bass} of the bass"
        if self.melody_kept == self.bass_kept == 1:
            summary = "melody and bass whole"
        summary += f", {_percent(self.others_kept)} of the other notes"
        if self.notes_moved:
            summary += f", {self.notes_moved} moved by octaves"
        if self.notes_added:
            summary += f", {self.notes_added} struck again"
        return summary


NOTHING_LOST = Fidelity(1.0, 1.0, 1.0, 1.0, 0, 0)


def _in_words(share: float) -> str:
    if share in (0, 1):
        return "all" if share else "none"
    return f"{int(1000 * share) / 1000:.1%}"  # never 100 %


def _percent(share: float) -> str:
    percent = round(100 * share)
    return f"{min(percent, 99) if share < 1 else percent}%"  # 100 % only where all are played


def fates_of(song: Sequence[SourceNote], struck: Iterable[Struck]) -> tuple[Fate, ...]:
    """The fates of all notes of a song, and of notes that were struck again, by their start."""
    played = {each.source: each.pitch for each in struck}
    added = [source for source in played if source.added]
    notes = sorted((*song, *added), key=lambda note: (note.start, note.pitch))
    return tuple(Fate(note, played.get(note)) for note in notes)


def fidelity_of(fates: Sequence[Fate], arranged: Score, beats: Sequence[float]) -> Fidelity:
    """Compare an arrangement with the song, whose beats begin at these times [s]."""
    song = [fate for fate in fates if not fate.note.added]
    song_notes = [fate.note for fate in song]
    sounding, played = pitch_classes(song_notes, beats), pitch_classes(arranged.notes, beats)
    return Fidelity(
        melody_kept=_share(fate for fate in song if fate.note.melody),
        bass_kept=_share(fate for fate in song if fate.note.bass),
        others_kept=_share(fate for fate in song if not fate.note.melody and not fate.note.bass),
        pitch_classes_kept=float((sounding & played).sum() / max(sounding.sum(), 1)),
        notes_moved=sum(fate.played not in (None, fate.note.pitch) for fate in fates),
        notes_added=len(fates) - len(song),
    )


def _share(fates: Iterable[Fate]) -> float:
    """The share of notes that are played."""
    played = [fate.played is not None for fate in fates]
    return sum(played) / len(played) if played else 1.0


def pitch_classes(
    notes: Iterable[SourceNote] | Iterable[Note], beats: Sequence[float]
) -> NDArray[np.bool_]:
    """(B, 12) the pitch classes that sound in each beat."""
    table = np.zeros((len(beats), OCTAVE), bool)
    for note in notes:
        first = max(bisect_right(beats, note.start + TOGETHER) - 1, 0)
        end = max(bisect_right(beats, note.end - TOGETHER), first + 1)
        table[first:end, note.pitch % OCTAVE] = True
    return table
