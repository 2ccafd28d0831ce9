"""A folder of files of music as a library."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path

from cadenza.errors import CadenzaError
from cadenza.music.index import INDEX, Facts, read_index
from cadenza.music.reading import MUSIC, read_score
from cadenza.music.songs import Library, Song


def folder_library(folder: Path, name: str = "") -> Library:
    """The files of music in a folder and the folders in it; none of them is opened.

    Args:
        folder: where they are, with an index if there is one (see `cadenza.music.index`).
        name: of the library, whose songs are then called `name/piece`. Without it they are called
            by their paths.

    Raises:
        CadenzaError: there are none, or the index cannot be read.
    """
    files = music_files(folder)
    if not files:
        raise CadenzaError(f"{folder}: there is no file of music in it ({', '.join(MUSIC)})")
    index = index_of(folder)
    names = unique(file.stem for file in files)
    songs = (
        Song(
            f"{name}/{piece}" if name else str(folder / file),
            partial(read_score, folder / file),
            **facts_of(file, index),
        )
        for piece, file in zip(names, files, strict=True)
    )
    return Library(name or str(folder), tuple(songs))


def music_files(folder: Path) -> list[Path]:
    """Paths within the folder, in alphabetical order; what is hidden is left out."""
    return sorted(_music_files(folder))


def _music_files(folder: Path) -> Iterator[Path]:
    for place, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for name in files:
            path = Path(place, name)
            if path.suffix.lower() in MUSIC and not name.startswith("."):
                yield path.relative_to(folder)


def index_of(folder: Path) -> dict[str, Facts]:
    """What the folder's index says; nothing where there is none.

    Raises:
        CadenzaError: it cannot be read.
    """
    return read_index(folder / INDEX) if os.path.isfile(folder / INDEX) else {}


def facts_of(file: Path, index: Mapping[str, Facts]) -> Facts:
    """What an index says of a file, however it names it."""
    return next((index[name] for name in names_of(file) if name in index), {})


def names_of(file: Path) -> tuple[str, ...]:
    """How an index may name a file: by its path or by its name, with its ending or without."""
    return file.as_posix(), file.with_suffix("").as_posix(), file.name, file.stem


def unique(names: Iterable[str]) -> list[str]:
    """The names, those that are taken with a number; upper and lower case are the same."""
    taken: set[str] = set()
    numbers: Counter[str] = Counter()
    result = []
    for name in names:
        new = name
        while new.casefold() in taken:
            numbers[name] += 1
            new = f"{name}-{numbers[name] + 1}"
        taken.add(new.casefold())
        result.append(new)
    return result
