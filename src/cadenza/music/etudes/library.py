"""Etudes as a song library: `etudes:N`, or `etudes:N:SEED`."""

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


def etude_library(which: str = str(_SOME)) -> Library:
    """Etudes of all kinds and difficulties.

    Args:
        which: how many, such as "300", and perhaps the seed that they are drawn from: "300:1".

    Raises:
        CadenzaError: `which` is nothing like this.
    """
    if not _WHICH.fullmatch(which):
        raise CadenzaError(
            f"{LIBRARY}:{which}: give how many, such as {LIBRARY}:300, or {LIBRARY}:300:1 with a "
            "seed"
        )
    names = etude_names(*map(int, which.split(":")))
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
