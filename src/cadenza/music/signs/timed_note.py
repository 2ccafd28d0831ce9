"""Notes while their signs are realised, and the voices that they are in."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

from cadenza.music.signs.signed_note import SignedNote

SHORTEST = 0.05
"""How long a note lasts at least that a sign makes shorter, if it is written so [s]; a choice, as
long as a control step."""


@dataclass(slots=True, eq=False)
class TimedNote:
    """A note as it is to sound from `start` to `end` [s], before ornaments divide it.

    `cut` is whether a sign has made it end earlier than it is written, and `led_to` whether a grace
    note leads to it.
    """

    of: SignedNote
    start: float
    end: float
    velocity: float
    cut: bool = False
    led_to: bool = False

    @property
    def length(self) -> float:
        """How long the note lasts [s]."""
        return self.end - self.start

    def end_by(self, time: float) -> None:
        """Ends the note at a time [s] or before, but not before it has sounded."""
        if time < self.end:
            self.end = max(time, self.start + min(self.length, SHORTEST))
            self.cut = True


Chord = list[TimedNote]
Times = list[tuple[float, float]]
"""Notes sound from the first time [s] of each pair up to the second."""


def even_times(start: float, end: float, count: int) -> Times:
    """The times of `count` notes that share the time between two [s] evenly."""
    return list(pairwise([*(start + (end - start) * k / count for k in range(count)), end]))


@dataclass(slots=True)
class Voice:
    """One voice of a part: its chords by onset [quarters], and the grace notes at each onset.

    Both are in order of time; grace notes of one place are chords, too, in their order.
    """

    part: int
    name: str
    chords: dict[Fraction, Chord]
    graces: dict[Fraction, list[Chord]]


def voices_of(notes: Iterable[TimedNote]) -> list[Voice]:
    """The voices that notes are in."""
    voices: dict[tuple[int, str], Voice] = {}
    indices: dict[tuple[int, str, Fraction], dict[int, Chord]] = {}
    for note in sorted(notes, key=lambda note: note.of.onset):
        of = note.of
        voice = voices.setdefault((of.part, of.voice), Voice(of.part, of.voice, {}, {}))
        if of.grace is None:
            voice.chords.setdefault(of.onset, []).append(note)
        else:
            chords = indices.setdefault((of.part, of.voice, of.onset), {})
            chords.setdefault(of.grace.index, []).append(note)
    for (part, name, onset), chords in indices.items():
        voices[part, name].graces[onset] = [chords[index] for index in sorted(chords)]
    return list(voices.values())
