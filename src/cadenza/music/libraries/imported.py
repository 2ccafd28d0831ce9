"""The libraries that a user has imported, each in a folder of its own with an index and files.

The index is written last, as a whole, and says in which folder the files are. So a library is the
old one or the new one, whenever an import is interrupted.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Protocol

from cadenza.errors import CadenzaError, is_full
from cadenza.files import locked_file
from cadenza.music.formats.reading import read_score
from cadenza.music.libraries.index import INDEX, Facts, read_index, write_index
from cadenza.music.libraries.songs import Library, Song
from cadenza.music.libraries.user_data import libraries_folder
from cadenza.music.score import Score

_NAME = re.compile(r"\w[\w.-]{0,63}")
_FILES = "files-"  # what the name of the folder of files begins with


def imported_libraries() -> list[str]:
    """Their names, in alphabetical order."""
    try:
        names = os.listdir(libraries_folder())
    except OSError:
        return []
    return sorted(name for name in names if is_imported(name))


def is_imported(name: str) -> bool:
    """Whether there is such a library."""
    return bool(_NAME.fullmatch(name)) and os.path.isfile(libraries_folder() / name / INDEX)


def imported(name: str) -> Library:
    """One that has been imported; only its index is read.

    Raises:
        CadenzaError: it is not there, or its index is damaged.
    """
    folder = libraries_folder() / name
    songs = (
        Song(f"{name}/{Path(file).stem}", partial(read_score, folder / file), **facts)
        for file, facts in read_index(folder / INDEX).items()
    )
    return Library(name, tuple(songs))


class Progress(Protocol):
    """What an import calls as it gets on."""

    def __call__(self, done: int, total: int) -> None:
        """Pieces done and in all."""


Grade = Callable[[Score], float]
"""How difficult a score is, from 1 to 10."""


def silent(done: int, total: int) -> None:
    """Tells nobody."""


@dataclass(frozen=True)
class NewLibrary:
    """A library that is being made: files go into `folder`."""

    name: str
    folder: Path
    grade: Grade | None = None
    rows: list[tuple[str, Facts]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """What could not be read, and why."""
    doubtful: list[str] = field(default_factory=list)
    """What looks wrong but could be read."""

    def add(self, file: str, score: Score, facts: Facts) -> None:
        """Has a piece listed.

        Args:
            file: its name in the folder; what stands before its ending is the name of the piece.
            score: what is in it, which is counted now, so that no listing has to read it.
            facts: what else is known of it.
        """
        difficulty = None if self.grade is None else round(self.grade(score), 2)
        counted = {**_counted(score), "difficulty": difficulty}
        self.rows.append((f"{self.folder.name}/{file}", {**facts, **counted}))

    @contextmanager
    def leaving_out_what_is_wrong(self) -> Iterator[None]:
        """Goes on after an error, which is noted.

        Raises:
            OSError: the disk is full, of which the next piece would only tell again.
        """
        try:
            yield
        except (CadenzaError, OSError) as error:
            if is_full(error):
                raise
            self.left_out.append(str(error))


@contextmanager
def new_library(
    name: str, replace: bool = False, grade: Grade | None = None
) -> Iterator[NewLibrary]:
    """Yields a library to add pieces to, which is there when the block ends without an error.

    Args:
        name: of the library.
        replace: whether it may take the place of one that is there.
        grade: what says how difficult a piece is; that is not known without it.

    Raises:
        CadenzaError: the name cannot be one, there is such a library, nothing has been added, or
            another import is running.
    """
    if not _NAME.fullmatch(name):
        raise CadenzaError(
            f"library name {name!r}: give up to 64 letters, digits, dots, dashes or underscores"
        )
    all_libraries = libraries_folder()
    place = all_libraries / name
    all_libraries.mkdir(parents=True, exist_ok=True)
    with locked_file(all_libraries / ".lock") as ours:
        if not ours:
            raise CadenzaError("another import is running; try again when it has ended")
        if is_imported(name) and not replace:
            raise CadenzaError(
                f"there is a library {name} already; import with --replace to replace it, or "
                "choose another --name"
            )
        library = NewLibrary(name, place / f"{_FILES}{secrets.token_hex(4)}", grade)
        try:
            library.folder.mkdir(parents=True)
            yield library
            if not library.rows:
                first = "".join(library.left_out[:1])
                raise CadenzaError(f"{name}: not one piece can be read; {first or 'none is there'}")
            write_index(place / INDEX, library.rows)
        except BaseException:
            shutil.rmtree(library.folder, ignore_errors=True)
            raise
        finally:
            _tidy(place)


def _tidy(place: Path) -> None:
    """Removes files that belong to no library any more, and the folder if nothing is in it."""
    with suppress(CadenzaError):
        index = read_index(place / INDEX) if os.path.isfile(place / INDEX) else {}
        kept = {file.split("/")[0] for file in index}
        for folder in place.glob(f"{_FILES}*"):
            if folder.name not in kept:
                shutil.rmtree(folder, ignore_errors=True)
    with suppress(OSError):
        place.rmdir()


def _counted(score: Score) -> Facts:
    """What a listing says of a score."""
    return {
        "seconds": round(score.total_time, 2),
        "notes": len(score.notes),
        "hands": _hands(score),
    }


def _hands(score: Score) -> int | None:
    """How many play, by the fingers or the tracks; None if neither says."""
    hands = {note.finger.hand for note in score.notes if note.finger}
    return len(hands) or (2 if len(score.tracks) > 1 else None)
