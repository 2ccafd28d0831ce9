"""The plan of a song: its key and tempo, its sections and their chords."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate

import numpy as np

from cadenza.music.etudes.band.chords import harmonies
from cadenza.music.etudes.band.parts import TICKS_PER_BEAT, microseconds_per_beat, seconds
from cadenza.music.etudes.band.passage import Passage, happens, pick
from cadenza.music.etudes.band.styles import SECTIONS, Style
from cadenza.music.etudes.keys import Key

SHORTEST, LONGEST = 60.0, 180.0  # [s] of a song
_ACCIDENTALS = 4  # at most
_INSTEAD = {"intro": "verse", "outro": "chorus", "solo": "verse", "chorus": "verse"}
"""Sections whose chords are those of another, where the style has none of their own."""
_RAISES = 15  # [%] of songs in which the last chorus is higher
_RAISED = {1: -5, 2: 2}
"""Semitones by which the last chorus may be higher -> how many sharps its key has more."""


@dataclass(frozen=True)
class Plan:
    """What holds for a whole song, with quarters a minute as `tempo`."""

    style: Style
    key: Key
    tempo: int
    passages: tuple[Passage, ...]

    @cached_property
    def starts(self) -> list[int]:
        """The quarters at which sections begin."""
        return [0, *accumulate(passage.length for passage in self.passages[:-1])]

    @property
    def placed(self) -> Iterator[tuple[Passage, int]]:
        """The sections and the quarters at which they begin."""
        return zip(self.passages, self.starts, strict=True)

    def passage(self, at: float) -> Passage:
        """The section in which a time [quarters] lies; the first before the song."""
        return self.passages[max(bisect_right(self.starts, at) - 1, 0)]

    def ticks(self, at: float) -> int:
        """The ticks of a time [quarters]; in swing, the first half of each beat is the longer."""
        swing = self.style.swing
        beat, within = divmod(at, 1)
        if within <= 0.5:
            within *= 2 * swing
        else:
            within = swing + (2 * within - 1) * (1 - swing)
        return round((beat + within) * TICKS_PER_BEAT)

    def seconds(self, at: float) -> float:
        """The time [s] of a time in quarters."""
        return seconds(self.ticks(at), self.tempo)


def planned(rng: np.random.Generator, style: Style) -> Plan:
    """The plan of a song of a style; sections of the same kind have the same chords."""
    minor = happens(rng, style.minor)
    key = Key(int(rng.integers(-_ACCIDENTALS, _ACCIDENTALS, endpoint=True)), minor)
    tempo = pick(rng, style.tempi)
    kinds = pick(rng, _fitting_forms(style, tempo))
    written = {kind: _numerals(rng, style, minor, kind) for kind in dict.fromkeys(kinds)}
    raised = pick(rng, list(_RAISED)) if "chorus" in kinds and happens(rng, _RAISES) else 0
    last_chorus = len(kinds) - 1 - kinds[::-1].index("chorus") if raised else len(kinds)
    passages = []
    for i, kind in enumerate(kinds):
        by = raised if i >= last_chorus else 0
        here = Key(key.sharps + _RAISED[by], minor) if by else key
        bars = style.bars[kind]
        chords = harmonies(written[kind], here, style.beats, bars)
        final = kind == "ending"
        passages.append(Passage(kind, here, style.beats, bars, chords, rng, final, by))
    return Plan(style, key, tempo, tuple(passages))


def _fitting_forms(style: Style, tempo: int) -> list[list[str]]:
    """The forms that last neither too short nor too long; the nearest if there is none."""
    forms = [[SECTIONS[letter] for letter in form] for form in style.forms]
    beat = microseconds_per_beat(tempo) / 1e6

    def excess(form: Sequence[str]) -> float:
        length = sum(style.bars[kind] for kind in form) * style.beats * beat
        return max(SHORTEST - length, length - LONGEST, 0.0)

    return [form for form in forms if excess(form) == 0] or [min(forms, key=excess)]


def _numerals(rng: np.random.Generator, style: Style, minor: bool, kind: str) -> str:
    if kind == "ending":
        return "i" if minor else "I"
    known = style.progressions["minor" if minor else "major"]
    while kind not in known:
        kind = _INSTEAD[kind]
    return pick(rng, known[kind])
