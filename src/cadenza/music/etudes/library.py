"""Etudes by kind, difficulty and seed, and the library of them.

The names of libraries are `etudes:N`, `etudes:N:SEED`, and `etudes:KIND-DIFFICULTY:N`.
"""

import re
import zlib
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np

from cadenza.configs import MAX_SEED, whole_number
from cadenza.errors import CadenzaError, quoted
from cadenza.music.etudes.harmony import random_key
from cadenza.music.etudes.homophony import (
    alberti,
    arpeggios,
    broken_chords,
    leaps,
    repeated_notes,
    trills,
)
from cadenza.music.etudes.polyphony import chorale, counterpoint
from cadenza.music.etudes.scales import DRILLS, drill, hanon, scales
from cadenza.music.etudes.sheet import EtudeSheet, Tone, pick
from cadenza.music.libraries.songs import Library, Song
from cadenza.music.score import Score

HARDEST = 10  # the highest difficulty of an etude; the lowest is 1
LIBRARY = "etudes"  # the name of the library, with which the names of its etudes begin
_TEMPI = range(50, 141)  # [beats / min] preferred tempi
_USUAL_TEMPO = 90  # [beats / min] that etudes come near to if none is among the preferred
_TEMPO_VARIATION = 0.08  # share by which tempi differ at random
_DEFAULT_COUNT = 100


@dataclass(frozen=True)
class _EtudeKind:
    """A kind of etude: how it is written, and its steps a second at difficulties 1 and 10."""

    title: str
    write: Callable[[EtudeSheet], Iterator[Tone]]
    slowest: float
    fastest: float
    divisions: tuple[int, ...] = (1, 2, 4)
    metres: tuple[int, ...] = (4,)


_KINDS = {
    "scales": _EtudeKind("Scales", scales, 1.5, 10),
    "arpeggios": _EtudeKind("Arpeggios", arpeggios, 1.3, 8, (1, 2, 3, 4)),
    "broken-chords": _EtudeKind("Broken chords", broken_chords, 1.4, 8),
    "hanon": _EtudeKind("Finger exercise", hanon, 1.5, 9),
    "alberti": _EtudeKind("Alberti bass", alberti, 1.6, 8),
    "chorale": _EtudeKind("Chorale", chorale, 1.2, 4, (2,)),
    "counterpoint": _EtudeKind("Counterpoint", counterpoint, 0.8, 6),
    "leaps": _EtudeKind("Leaps", leaps, 1, 6, (1, 2), (3, 4)),
    "trills": _EtudeKind("Trills", trills, 2.5, 11, (2, 4)),
    "repeated-notes": _EtudeKind("Repeated notes", repeated_notes, 1.5, 8),
}
KINDS = tuple(_KINDS)  # kinds of etudes for two hands; those for one are `DRILLS`
_ETUDE_NAME = re.compile(rf"{LIBRARY}/([a-z-]+)-(\d{{1,9}})-(\d{{1,39}})", re.ASCII)
_COUNT_AND_SEED = re.compile(r"\d{1,9}(:\d{1,9})?", re.ASCII)
_OF_ONE_KIND = re.compile(r"([a-z-]+-\d{1,9}):([1-9]\d{0,5})", re.ASCII)


def make_etude(kind: str, difficulty: int, seed: int) -> Score:
    """An etude of 15 to 40 s for two hands, or a drill for one, both without fingers.

    Raises CadenzaError if there is no such kind, difficulty or seed.

    Args:
        kind: one of `KINDS` or `DRILLS`.
        difficulty: 1 to 10: tempo, range, accidentals, how much the hands do at once; of a drill,
            how many notes or chords there are.
        seed: the seed of key, tempo, chords and voices; the same seed gives the same etude.
    """
    kind, difficulty, seed = _checked(kind, difficulty, seed)
    rng = np.random.default_rng([zlib.crc32(kind.encode()), difficulty, seed])
    if kind in DRILLS:
        return drill(kind, difficulty, rng)
    sheet = _sheet(_KINDS[kind], difficulty, rng)
    notes = tuple(sheet.note(tone) for tone in _KINDS[kind].write(sheet))
    title = f"{_KINDS[kind].title} in {sheet.key.name}, {difficulty}"
    return Score(notes, title=title, bars=sheet.numbered_bars)


def _checked(kind: str, difficulty: int, seed: int) -> tuple[str, int, int]:
    if kind not in (*KINDS, *DRILLS):
        kinds = ", ".join((*KINDS, *DRILLS))
        raise CadenzaError(f"no etudes of kind {quoted(kind)}: choose from {kinds}")
    difficulty = whole_number(difficulty, "difficulty", 1, HARDEST)
    return kind, difficulty, whole_number(seed, "seed", 0, MAX_SEED)


def _sheet(kind: _EtudeKind, difficulty: int, rng: np.random.Generator) -> EtudeSheet:
    """A sheet with a random key, metre and tempo; steps a second are exponential in difficulty."""
    key = random_key(rng, difficulty - 1)
    beats = pick(rng, kind.metres)
    rise = (difficulty - 1) / (HARDEST - 1)
    rate = kind.slowest * (kind.fastest / kind.slowest) ** rise
    rate *= 1 + _TEMPO_VARIATION * (2 * rng.random() - 1)
    tempi = {division: round(60 * rate / division) for division in kind.divisions}
    usual = [division for division, tempo in tempi.items() if tempo in _TEMPI]
    usual = usual or [min(tempi, key=lambda division: abs(tempi[division] - _USUAL_TEMPO))]
    division = pick(rng, usual)
    return EtudeSheet(difficulty, rng, key, tempi[division], beats, division)


# Names


def etude_name(kind: str, difficulty: int, seed: int) -> str:
    """A name such as "etudes/scales-3-7", which can be given wherever a song can."""
    return f"{LIBRARY}/{kind}-{difficulty}-{seed}"


def etude_names(count: int, seed: int = 0) -> list[str]:
    """Names of `count` etudes, spread evenly over kinds and difficulties in a random order.

    The first of a longer list are those of a shorter one with the same seed. Raises CadenzaError if
    `seed` or `count` is no such number.
    """
    count = whole_number(count, "count", 1, 1_000_000)
    rng = np.random.default_rng(whole_number(seed, "seed", 0, MAX_SEED))
    names: list[str] = []
    combinations = list(product(KINDS, range(1, HARDEST + 1)))
    while len(names) < count:
        for i in np.argsort(rng.random(len(combinations)), kind="stable"):
            kind, difficulty = combinations[i]
            names.append(etude_name(kind, difficulty, int(rng.integers(2**31))))
    return names[:count]


# As a song library


def etude_library(which: str = str(_DEFAULT_COUNT)) -> Library:
    """A library of etudes of all kinds and difficulties, or of one.

    Raises CadenzaError if `which` has another form.

    Args:
        which: the number of etudes, such as "300", or with a seed "300:1"; or a kind, a difficulty
            and the number, with the seeds 0, 1 and so on: "notes-6:20".
    """
    if of_one_kind := _OF_ONE_KIND.fullmatch(which.lower()):
        names = [f"{LIBRARY}/{of_one_kind[1]}-{seed}" for seed in range(int(of_one_kind[2]))]
    elif _COUNT_AND_SEED.fullmatch(which):
        names = etude_names(*map(int, which.split(":")))
    else:
        raise CadenzaError(
            f"{LIBRARY}:{which}: give how many, such as {LIBRARY}:300, {LIBRARY}:300:1 with a "
            f"seed, or {LIBRARY}:scales-3:20 of one kind and difficulty"
        )
    return Library(f"{LIBRARY}:{which}", tuple(map(etude_song, names)))


def etude_song(name: str) -> Song:
    """The song of a name such as "etudes/scales-3-7"; its grade is the difficulty asked for.

    Raises CadenzaError if no etude is called so.
    """
    match = _ETUDE_NAME.fullmatch(name.lower())
    if not match:
        raise CadenzaError(
            f"no etude named {quoted(name)}: give {LIBRARY}/KIND-DIFFICULTY-SEED, "
            f"such as {LIBRARY}/scales-3-7"
        )
    which = _checked(match[1], int(match[2]), int(match[3]))
    read, difficulty = partial(_read, *which), float(which[1])
    return Song(etude_name(*which), read, source="practice piece", difficulty=difficulty)


def _read(kind: str, difficulty: int, seed: int, tracks: Collection[int], _plain: bool) -> Score:
    if tracks:
        name = etude_name(kind, difficulty, seed)
        raise CadenzaError(f"{name}: an etude has no tracks to choose from")
    return make_etude(kind, difficulty, seed)
