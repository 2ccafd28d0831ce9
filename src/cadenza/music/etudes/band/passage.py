"""A section of a song as its players see it: chords and bars, without a place in time."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from cadenza.music.etudes.band.chords import Harmony, SongChord
from cadenza.music.etudes.keys import Key
from cadenza.music.etudes.sheet import Tone


@dataclass(frozen=True, eq=False)
class SongPassage:
    """A section: its kind, such as "verse", its length in bars, its chords.

    All times are in quarters from its beginning. `rng` is for those who play it.
    """

    kind: str
    key: Key
    beats: int
    """Quarters in a bar."""
    bars: int
    harmonies: tuple[Harmony, ...]
    rng: np.random.Generator
    final: bool = False
    """Whether it is the last chord of the song, which all hold."""
    raised: int = 0
    """Semitones by which it is higher than the beginning of the song."""

    @property
    def length(self) -> int:
        """Quarters of the section."""
        return self.bars * self.beats

    @cached_property
    def _starts(self) -> list[float]:
        return [harmony.at for harmony in self.harmonies]

    def harmony(self, at: float) -> int:
        """The index of the harmony that sounds at a time; of the first before the section."""
        return max(bisect_right(self._starts, at) - 1, 0)

    def chord(self, at: float) -> SongChord:
        """The chord that sounds at a time."""
        return self.harmonies[self.harmony(at)].chord

    @property
    def chords(self) -> tuple[SongChord, ...]:
        """The chords in their order."""
        return tuple(harmony.chord for harmony in self.harmonies)

    def in_bars(self, rhythm: Sequence[tuple[float, float]]) -> Iterator[tuple[float, float]]:
        """Yields onset and length of the notes of a rhythm of one or more bars, said again.

        Notes end with the harmony in which they begin. In the final chord there is one note.
        """
        if self.final:
            yield 0.0, float(self.length)
            return
        bars = 1 + int(max(at for at, _ in rhythm)) // self.beats
        for bar in range(0, self.bars, bars):
            for at, length in rhythm:
                start = bar * self.beats + at
                if start < self.length:
                    harmony = self.harmonies[self.harmony(start)]
                    yield start, min(length, harmony.at + harmony.length - start)


def happens(rng: np.random.Generator, percent: int) -> bool:
    """Whether something happens that does so in `percent` of all cases."""
    return int(rng.integers(100)) < percent


def one_at_a_time(tones: Sequence[Tone]) -> list[Tone]:
    """The tones in order of their onsets, each ending where the next begins."""
    tones = sorted(tones, key=lambda tone: tone.at)
    kept = [
        replace(tone, length=min(tone.length, after.at - tone.at))
        for tone, after in pairwise(tones)
        if after.at > tone.at
    ]
    return [*kept, *tones[-1:]]
