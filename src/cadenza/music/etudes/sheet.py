"""The sheet of an etude: its key, tempo, metre and notes."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from cadenza.fingers import SIDES, Side
from cadenza.music.etudes.harmony import STEPS, TONIC, Key, Triad, progression
from cadenza.music.score import Bar, Note

Choice = TypeVar("Choice")

PHRASE = 4  # bars
_BOTH_HANDS = 6  # difficulty from which both hands play figures at once
_SHORTEST = 18.0  # [s] length of an etude, which is rounded up to whole phrases
_RELEASE = 0.05  # [s] by which a note ends early, so that its key can come up
_RELEASE_SHARE = 0.25  # share of a note by which short notes end early instead
_ACCENT = 12  # additional velocity of notes that begin a bar


def pick(rng: np.random.Generator, choices: Sequence[Choice]) -> Choice:
    """A random one of the choices."""
    return choices[int(rng.integers(len(choices)))]


@dataclass(frozen=True)
class Tone:
    """A note that begins at `at` and lasts `length`, both in steps."""

    at: float
    length: float
    pitch: int
    velocity: int = 72


@dataclass(frozen=True, eq=False)
class EtudeSheet:
    """Difficulty, key and time of an etude, and the generator of its random choices."""

    difficulty: int
    rng: np.random.Generator
    key: Key
    tempo: int  # beats a minute
    beats: int  # beats in a bar
    division: int  # steps in a beat. A step is the shortest note in most kinds.

    @property
    def bar(self) -> int:
        """Steps in a bar."""
        return self.beats * self.division

    @property
    def bars(self) -> int:
        """Bars of the etude, in whole phrases."""
        phrase = PHRASE * self.beats * 60 / self.tempo
        return PHRASE * -int(-_SHORTEST // phrase)

    @property
    def length(self) -> int:
        """Steps of the etude."""
        return self.bar * self.bars

    @property
    def thickness(self) -> int:
        """Number of notes in a chord of one hand."""
        return 1 if self.difficulty <= 2 else 2 if self.difficulty <= 4 else 3

    def pitch(self, degree: int, chord: Triad | None = None) -> int:
        """The pitch of a degree of the scale, over a chord if one is given."""
        return self.key.pitch(degree, chord.form if chord else "natural")

    def voicing(self, chord: Triad, lowest: int, count: int) -> list[int]:
        """Pitches of `count` tones of a chord in close position, from its tone `lowest` upwards."""
        return [self.pitch(chord.tone(lowest + i), chord) for i in range(count)]

    def chords(self) -> list[Triad]:
        """A progression of a chord for each bar."""
        return progression(self.rng, self.bars // PHRASE, PHRASE)

    def ending(self, right: int = 0) -> list[Tone]:
        """A tonic chord for the last bar, upwards from a degree of the right hand, over a bass."""
        chord = Triad(TONIC)
        upper = self.voicing(chord, chord.nearest(right), self.thickness)
        pitches = (*upper, self.pitch(chord.root - STEPS))
        return [Tone(self.length - self.bar, self.bar, pitch) for pitch in pitches]

    def hands(self, bar: int) -> tuple[Side, ...]:
        """The hands that have the figure in a bar: one by phrases, in harder etudes both."""
        if self.difficulty >= _BOTH_HANDS:
            return SIDES
        return (SIDES[(bar // PHRASE) % 2],)

    @property
    def numbered_bars(self) -> tuple[Bar, ...]:
        """The bars with their times [s], in beats of a quarter."""
        begins = [bar * self.bar for bar in range(self.bars)]
        return tuple(
            Bar(
                begin * self._step,
                number,
                tuple(at * self._step for at in range(begin, begin + self.bar, self.division)),
            )
            for number, begin in enumerate(begins, start=1)
        )

    @property
    def _step(self) -> float:
        """Length of a step [s]."""
        return 60 / (self.tempo * self.division)

    def note(self, tone: Tone) -> Note:
        """The note in seconds, louder where a bar begins."""
        step = self._step
        seconds = tone.length * step
        start = tone.at * step
        accent = _ACCENT if tone.at % self.bar == 0 else 0
        end = start + seconds - min(_RELEASE, _RELEASE_SHARE * seconds)
        return Note(start, end, tone.pitch, tone.velocity + accent)
