"""Scores in the JSON files of runs and policies."""

from __future__ import annotations

from dataclasses import dataclass

from cadenza.fingers import finger_from, finger_number
from cadenza.music.score import Bar, Note, PedalEvent, Score, Track


@dataclass(frozen=True)
class WrittenNote:
    """A `Note` whose finger has its number in files."""

    start: float
    end: float
    pitch: int
    velocity: int
    finger: int | str
    hands: tuple[int, ...] = ()


@dataclass(frozen=True)
class WrittenScore:
    """A `Score` of written notes."""

    notes: tuple[WrittenNote, ...]
    pedal: tuple[PedalEvent, ...] = ()
    title: str = ""
    remarks: tuple[str, ...] = ()
    tracks: tuple[Track, ...] = ()
    bars: tuple[Bar, ...] = ()

    @classmethod
    def of(cls, score: Score) -> WrittenScore:
        """Convert a score."""
        notes = (
            WrittenNote(n.start, n.end, n.pitch, n.velocity, finger_number(n.finger), n.hands)
            for n in score.notes
        )
        return cls(tuple(notes), score.pedal, score.title, score.remarks, score.tracks, score.bars)

    @property
    def score(self) -> Score:
        """The score. Raises CadenzaError if a note, or its finger, is not possible."""
        notes = (
            Note(n.start, n.end, n.pitch, n.velocity, finger_from(n.finger), hands=n.hands)
            for n in self.notes
        )
        return Score(tuple(notes), self.pedal, self.title, self.remarks, self.tracks, self.bars)
