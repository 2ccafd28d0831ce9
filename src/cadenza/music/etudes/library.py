"""Etudes as a song library: `etudes:N`, `etudes:N:SEED`, or `etudes:KIND-DIFFICULTY:N`."""

from __future__ import annotations

import re
from collections.abc import Collection
from functools import partial

from cadenza.errors import CadenzaError
from cadenza.music.etudes.etude import (
    LIBRARY,
    etude,
    etude_name,
    etude_names,
    kind_difficulty_seed,
)
from cadenza.music.libraries.songs import Library, Song
from cadenza.music.score import Score

_SOME = 100
_WHICH = re.compile(r"\d{1,9}(:\d{1,9})?", re.ASCII)
_ALIKE = re.compile(r"([a-z-]+-\d{1,9}):([1-9]\d{0,5})", re.ASCII)


def etude_library(which: str = str(_SOME)) -> Library:
    """Etudes of all kinds and difficulties, or of one.

    Args:
        which: how many, such as "300", and perhaps the seed that they are drawn from: "300:1"; or
            a kind, a difficulty and how many, with the seeds 0, 1 and so on: "notes-6:20".

    Raises:
        CadenzaError: `which` is nothing like this.
    """
    if alike := _ALIKE.fullmatch(which.lower()):
        names = [f"{LIBRARY}/{alike[1]}-{seed}" for seed in range(int(alike[2]))]
    elif _WHICH.fullmatch(which):
        names = etude_names(*map(int, which.split(":")))
    else:
        raise CadenzaError(
            f"{LIBRARY}:{which}: give how many, such as {LIBRARY}:300, {LIBRARY}:300:1 with a "
            f"seed, or {LIBRARY}:scales-3:20 of one kind and difficulty"
        )
    return Library(f"{LIBRARY}:{which}", tuple(map(etude_song, names)))


def etude_song(name: str) -> Song:
    """The etude of a name such as "etudes/scales-3-7"; its grade is the difficulty asked for.

    Raises:
        CadenzaError: no etude is called so.
    """
    kind, difficulty, seed = kind_difficulty_seed(name)
    name = etude_name(kind, difficulty, seed)
    read = partial(_read, name)
    return Song(name, read, source="practice piece", difficulty=float(difficulty))


def _read(name: str, tracks: Collection[int]) -> Score:
    if tracks:
        raise CadenzaError(f"{name}: an etude has no tracks to choose from")
    return etude(name)
