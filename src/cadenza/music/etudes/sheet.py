"""What every etude is written on: key, tempo, bars."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadenza.fingers import SIDES, Side
from cadenza.music.etudes.harmony import TONIC, Chord, progression
from cadenza.music.etudes.keys import STEPS, Key
from cadenza.music.score import Bar, Note

PHRASE = 4  # bars
_TOGETHER = 6  # the difficulty from which both hands play figures at once
_SHORTEST = 18.0  # [s]
_RELEASE = 0.05  # [s] that a note ends before it should, or a quarter of it
_ACCENT = 12


@dataclass(frozen=True)
class Tone:
    """A note: when it begins and how long it is, in steps."""

    at: float
    length: float
    pitch: int
    velocity: int = 72


@dataclass(frozen=True, eq=False)
class Sheet:
    """Key and time of an etude, and what is drawn for it."""

    difficulty: int
    rng: np.random.Generator
    key: Key
    tempo: int
    """[beats / min]"""
    beats: int
    """In a bar."""
    division: int
    """Steps in a beat. A step is the shortest note in most kinds."""

    @property
    def bar(self) -> int:
        """Steps in a bar."""
        return self.beats * self.division

    @property
    def bars(self) -> int:
        """Whole phrases."""
        phrase = PHRASE * self.beats * 60 / self.tempo
        return PHRASE * -int(-_SHORTEST // phrase)

    @property
    def length(self) -> int:
        """Steps of the whole."""
        return self.bar * self.bars

    @property
    def thickness(self) -> int:
        """Notes of a chord that one hand plays."""
        return 1 if self.difficulty <= 2 else 2 if self.difficulty <= 4 else 3

    def pitch(self, degree: int, chord: Chord | None = None) -> int:
        """The pitch of a degree of the scale, over a chord."""
        return self.key.pitch(degree, chord.form if chord else "natural")

    def chords(self) -> list[Chord]:
        """One for each bar."""
        return progression(self.rng, self.bars // PHRASE, PHRASE)

    def pick(self, *choices: int) -> int:
        """One of them."""
        return choices[int(self.rng.integers(len(choices)))]

    def ending(self, right: int = 0, left: int = -STEPS) -> list[Tone]:
        """A tonic chord for the last bar, upwards from the degree of each hand."""
        at, chord = self.length - self.bar, Chord(TONIC)
        upper = [chord.tone(chord.nearest(right) + i) for i in range(self.thickness)]
        degrees = [*upper, chord.tone(3 * (left // STEPS))]
        return [Tone(at, self.bar, self.pitch(degree)) for degree in degrees]

    def hands(self, bar: int) -> tuple[Side, ...]:
        """Which have the figure in a bar: one of them by phrases, in harder etudes both."""
        if self.difficulty >= _TOGETHER:
            return SIDES
        return (SIDES[(bar // PHRASE) % 2],)

    @property
    def numbered_bars(self) -> tuple[Bar, ...]:
        """In seconds."""
        return tuple(Bar(bar * self.bar * self._step, bar + 1) for bar in range(self.bars))

    @property
    def _step(self) -> float:
        """[s]"""
        return 60 / (self.tempo * self.division)

    def note(self, tone: Tone) -> Note:
        """In seconds, louder where a bar begins."""
        step = self._step
        seconds = tone.length * step
        start = tone.at * step
        accent = _ACCENT if tone.at % self.bar == 0 else 0
        end = start + seconds - min(_RELEASE, seconds / 4)
        return Note(start, end, tone.pitch, tone.velocity + accent)
