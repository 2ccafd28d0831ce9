"""Chords of songs as Roman numerals, scales over them, and sections as their players see them."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from cadenza.music.etudes.keys import Key
from cadenza.music.etudes.sheet import Tone
from cadenza.music.score import OCTAVE

_DEGREES = {"I": 0, "II": 2, "III": 4, "IV": 5, "V": 7, "VI": 9, "VII": 11}
_ACCIDENTALS = {"": 0, "b": -1, "#": 1}
_QUALITIES = {
    "": (0, 4, 7),
    "m": (0, 3, 7),
    "6": (0, 4, 7, 9),
    "m6": (0, 3, 7, 9),
    "7": (0, 4, 7, 10),
    "maj7": (0, 4, 7, 11),
    "m7": (0, 3, 7, 10),
    "9": (0, 4, 7, 10, 14),
    "maj9": (0, 4, 7, 11, 14),
    "m9": (0, 3, 7, 10, 14),
    "7b9": (0, 4, 7, 10, 13),
    "add9": (0, 4, 7, 14),
    "sus4": (0, 5, 7),
    "7sus4": (0, 5, 7, 10),
    "m7b5": (0, 3, 6, 10),
    "dim7": (0, 3, 6, 9),
}
"""Semitones of the tones of chords above their roots."""
_NUMERAL = re.compile(r"([b#]?)([IViv]+)([a-z0-9]*)(?:/([b#]?)([IV]+))?")
_MAJOR_THIRD = 4  # [semitones]


@dataclass(frozen=True)
class SongChord:
    """A chord: the pitch classes of its root and its bass, and semitones above the root."""

    root: int
    intervals: tuple[int, ...]
    bass: int

    @cached_property
    def classes(self) -> tuple[int, ...]:
        """The pitch classes of its tones, from the root."""
        return tuple((self.root + interval) % OCTAVE for interval in self.intervals)

    @property
    def third(self) -> int:
        """The pitch class of the third, or of the fourth that stands for it."""
        return self.classes[1]

    @property
    def fifth(self) -> int:
        """The pitch class of the fifth."""
        return self.classes[2]

    def has(self, pitch: int) -> bool:
        """Whether a MIDI pitch, in any octave, is one of its tones."""
        return pitch % OCTAVE in self.classes


@dataclass(frozen=True)
class Harmony:
    """A chord that begins at `at` and lasts `length`, both in quarters from its section."""

    at: float
    length: float
    chord: SongChord


def harmonies(numerals: str, key: Key, beats: int, bars: int) -> tuple[Harmony, ...]:
    """The chords of a section, such as "I | vi | ii7 V7 | I", said again until it is full.

    Numerals are those of the major scale on the tonic, in minor keys too: "i | bVI | bVII | i". Of
    two chords in a bar of three quarters, the first has two.
    """
    written = [bar.split() for bar in numerals.split("|")]
    found = []
    for bar in range(bars):
        names = written[bar % len(written)]
        at = bar * beats
        for i, name in enumerate(names):
            length = beats // len(names) + (i < beats % len(names))
            found.append(Harmony(at, length, _chord(name, key)))
            at += length
    return tuple(found)


def _chord(name: str, key: Key) -> SongChord:
    match = _NUMERAL.fullmatch(name)
    assert match, f"not a chord: {name}"
    accidental, numeral, quality, bass_accidental, bass = match.groups()
    if numeral.islower() and not quality.startswith(("m", "dim")):
        quality = f"m{quality}"
    tonic = key.pitch(0)
    root = (tonic + _DEGREES[numeral.upper()] + _ACCIDENTALS[accidental]) % OCTAVE
    under = (tonic + _DEGREES[bass] + _ACCIDENTALS[bass_accidental]) % OCTAVE if bass else root
    return SongChord(root, _QUALITIES[quality], under)


_PENTATONIC = {False: (0, 2, 4, 7, 9), True: (0, 3, 5, 7, 10)}
_BLUES = (0, 3, 4, 5, 6, 7, 10)


def melody_scale(key: Key, chord: SongChord, colour: str) -> frozenset[int]:
    """The pitch classes that a melody has over a chord: a "scale", "pentatonic" or "blues".

    Tones of the chord that the key has not replace those next to them.
    """
    tonic = key.pitch(0)
    if colour == "blues":
        return frozenset((tonic + step) % OCTAVE for step in _BLUES)
    steps = _PENTATONIC[key.minor] if colour == "pentatonic" else key.scale()
    scale = {(tonic + step) % OCTAVE for step in steps}
    for interval in chord.intervals:
        tone = (chord.root + interval) % OCTAVE
        if tone not in scale:
            # A major third is raised, as in secondary dominants; other tones are lowered.
            instead = tone - 1 if interval == _MAJOR_THIRD else tone + 1
            scale.discard(instead % OCTAVE)
            scale.add(tone)
    return frozenset(scale | set(chord.classes))


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
        """Yield onset and length of the notes of a rhythm of one or more bars, said again.

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
