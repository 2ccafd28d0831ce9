"""Styles of songs: their tempi, forms and chord progressions, and who plays what in them."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

from cadenza.music.etudes.band.patterns import (
    VOICES,
    Pattern,
    approached,
    boom_chick,
    broken,
    chords,
    drums,
    held,
    patterned_bass,
    piano,
    picked,
    riff,
    walking_bass,
)
from cadenza.music.etudes.band.voicings import guitar, led_voicings, power_chord

_GUITAR = {"open_chords": guitar, "power_chords": power_chord}
SECTIONS = {
    "i": "intro",
    "v": "verse",
    "c": "chorus",
    "b": "bridge",
    "s": "solo",
    "o": "outro",
    "e": "ending",
}
"""Letter of a form -> kind of section."""
_BARS = {"intro": 4, "verse": 8, "chorus": 8, "bridge": 8, "solo": 8, "outro": 4, "ending": 1}

_USUAL_RANGE = (60, 84)
VOICE_RANGES = ((57, 76), (55, 74), (48, 67), (52, 71), (60, 79))
"""The ranges of voices: of women, of men, and of men written an octave higher."""
VOICE_PROGRAMS = frozenset((52, 53, 54, 85))


@dataclass(frozen=True)
class Chair:
    """An instrument of an accompaniment: what it plays, and on what.

    `names` are those its track may have, `programs` those of General MIDI, `share` the percentage
    of songs that have it, `sections` the kinds of sections in which it plays, all if empty.
    """

    plays: tuple[Pattern, ...]
    programs: tuple[int, ...]
    names: tuple[str, ...]
    share: int = 100
    sections: tuple[str, ...] = ()
    pedal: bool = False
    """Whether a sustain pedal is moved with the harmonies, if the song has one."""


@dataclass(frozen=True)
class Style:
    """A style: tempi in quarters a minute, `swing` as the share of a beat that its first half has.

    `forms` are sections in their order, `bars` how many bars of how many `beats` each kind has,
    `progressions` their chords in major and minor keys. `cells` are the kinds of rhythms of the
    melody, `colours` its scales, `leads` the programs that can have it, `solos` the programs that
    take it over for a section.
    """

    tempi: range
    minor: int
    """Percentage of songs in minor keys."""
    forms: tuple[str, ...]
    bars: Mapping[str, int]
    progressions: Mapping[str, Mapping[str, tuple[str, ...]]]
    cells: tuple[str, ...]
    colours: tuple[str, ...]
    leads: tuple[int, ...]
    solos: tuple[int, ...]
    bass: tuple[Pattern, ...]
    basses: tuple[int, ...]
    drums: Pattern
    chairs: tuple[Chair, ...]
    beats: int = 4
    swing: float = 0.5


@cache
def tables() -> dict[str, Any]:
    """Name -> table of styles.toml."""
    return tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))


@cache
def styles() -> dict[str, Style]:
    """Name -> style."""
    return {name: _style(about) for name, about in tables()["styles"].items()}


def range_of(program: int) -> tuple[int, int]:
    """The lowest and the highest pitch of melodies of an instrument, by its program."""
    low, high = tables()["ranges"].get(str(program), _USUAL_RANGE)
    return low, high


def _style(about: dict[str, Any]) -> Style:
    low, high = about["tempi"]
    return Style(
        **about
        | {
            "tempi": range(low, high + 1),
            "forms": tables()["forms"][about["forms"]].split(),
            "bars": _BARS | about.get("bars", {}),
            "progressions": tables()["progressions"][about["progressions"]],
            "bass": list(map(_bass, about["bass"])),
            "drums": drums(*about["drums"]),
            "chairs": list(map(_chair, about["chairs"])),
        }
    )


def _chair(about: dict[str, Any]) -> Chair:
    names = tables()["names"].get(about["names"], about["names"]).split(", ")
    plays = tuple(map(_pattern, about["plays"].split("; ")))
    return Chair(**about | {"names": names, "plays": plays})


def _bass(text: str) -> Pattern:
    """A bass by its name, with the percentage of roots that are approached, if any."""
    name, *percent = text.split()
    if name == "walking":
        return walking_bass
    play = patterned_bass(tables()["basses"][name])
    return approached(play, int(percent[0])) if percent else play


def _pattern(text: str) -> Pattern:
    """What an accompaniment plays: a function of `accompaniment` and its arguments."""
    match text.split():
        case ["picked"]:
            return picked
        case ["boom_chick"]:
            return boom_chick
        case ["held", voices]:
            return held(VOICES[voices])
        case ["riff", lowest]:
            return riff(int(lowest), *tables()["riffs"])
        case ["broken", lowest, step, *orders]:
            tones = (tuple(map(int, order.split("-"))) for order in orders)
            return broken(int(lowest), float(step), *tones)
        case [kind, voices, *names]:
            rhythms = [tables()["rhythms"][name] for name in names]
            if kind == "piano":
                return piano(VOICES[voices], *rhythms)
            if voices in _GUITAR:
                return chords(partial(map, _GUITAR[voices]), *rhythms)
            return chords(partial(led_voicings, slots=VOICES[voices]), *rhythms)
    raise ValueError(text)
