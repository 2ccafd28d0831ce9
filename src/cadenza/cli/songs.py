"""`cadenza songs` and `cadenza libraries`: lists of songs."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cadenza.errors import CadenzaError, CadenzaWarning, counted

if TYPE_CHECKING:
    from cadenza.music.libraries.songs import Library, Song

Sort = Literal["name", "length", "difficulty"]
_MAX_LETTERS = 100  # letters of a title or a name in a line


@dataclass(frozen=True)
class Songs:
    """List the songs of a library, or all songs that have a name.

    Example: cadenza songs bundled --sort length
    """

    library: Annotated[
        tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[LIBRARY[:SPLIT]]")
    ] = None
    """A library (see "cadenza libraries") or a folder, and which split of it."""
    sort: Sort | None = None
    """What to sort by; in the order of the library by default."""


@dataclass(frozen=True)
class Libraries:
    """List the song libraries: how many songs each has, and which splits."""


def songs(command: Songs) -> None:
    from cadenza.music.libraries.library import open_library

    chosen = command.library
    listed = _all_songs() if chosen is None else list(open_library(chosen).songs)
    if command.sort is not None:
        listed.sort(key=_KEYS[command.sort])
    width = max([34, *(len(song.name) for song in listed if len(song.name) <= 60)])
    for song in listed:
        print(_line(song, width))


def _all_songs() -> list[Song]:
    """The songs of all libraries once; a library that cannot be read is a warning."""
    from cadenza.music.libraries.library import distinct_libraries, open_library

    listed: list[Song] = []
    for name in distinct_libraries():
        try:
            listed += open_library(name).songs
        except CadenzaError as error:
            warnings.warn(str(error), CadenzaWarning, stacklevel=1)
    return listed


def libraries(_: Libraries) -> None:
    from cadenza.music.libraries.library import libraries as known
    from cadenza.music.libraries.library import open_library

    missing: dict[str, None] = {}
    for name, about in known().items():
        try:
            library = open_library(name)
            count, splits = counted(len(library.songs), "song"), _splits(library)
        except CadenzaError as error:
            count, splits = "not there", ""
            missing[str(error)] = None
        print(f"{name:20} {count:>11}  {about}{splits}")
    for message in missing:
        warnings.warn(message, CadenzaWarning, stacklevel=1)


def _splits(library: Library) -> str:
    """The sizes of a library's splits as text, such as "; valid 30, train 422"."""
    sizes = Counter(song.split for song in library.songs if song.split)
    return f"; {', '.join(f'{split} {n}' for split, n in sizes.items())}" if sizes else ""


def _line(song: Song, width: int) -> str:
    grade = "" if song.difficulty is None else f"{song.difficulty:.1f}"
    seconds = "" if song.seconds is None else f"{song.seconds:.1f} s"
    composer = f" ({song.composer:.{_MAX_LETTERS}})" if song.composer else ""
    title = f"{song.title or song.source:.{_MAX_LETTERS}}{composer}"
    return f"{song.name:{width}} {grade:>4} {seconds:>8}  {title}"


def _last_if_unknown(value: float | None) -> tuple[bool, float]:
    return value is None, value or 0.0


_KEYS: dict[Sort, Any] = {
    "name": lambda song: song.name.lower(),
    "length": lambda song: _last_if_unknown(song.seconds),
    "difficulty": lambda song: _last_if_unknown(song.difficulty),
}
