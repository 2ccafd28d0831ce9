"""The song libraries that a user has imported, each in a folder with an index and files.

They are in the user's data folder, or in the one that the environment variable CADENZA_DATA names.

An import fills a folder of another name, which takes the place of the library at last.
"""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from platformdirs import user_data_path

from cadenza.errors import CadenzaError, in_a_line, is_full, quoted
from cadenza.files import TEMPORARY, locked_file, new_folder
from cadenza.music.formats.reading import read_score
from cadenza.music.libraries.index import INDEX, Facts, read_index, write_index
from cadenza.music.libraries.songs import Library, Song
from cadenza.music.score import Score

_NAME = re.compile(r"\w[\w.-]{0,63}")

Progress = Callable[[int, int], None]
"""A function that an import calls with the number of pieces done and of all."""

Grade = Callable[[Score], float]  # a function that says how difficult a score is, from 1 to 10


def _libraries_folder() -> Path:
    chosen = os.environ.get("CADENZA_DATA")
    return (Path(chosen) if chosen else user_data_path("cadenza", appauthor=False)) / "libraries"


def imported_libraries() -> list[str]:
    """The names of imported libraries, in alphabetical order."""
    try:
        names = os.listdir(_libraries_folder())
    except OSError:
        return []
    return sorted(name for name in names if is_imported(name))


def is_imported(name: str) -> bool:
    """Whether a library of this name has been imported."""
    return bool(_NAME.fullmatch(name)) and os.path.isfile(_libraries_folder() / name / INDEX)


def imported(name: str) -> Library:
    """The library imported under a name, whose files are not read, or a CadenzaError."""
    folder = _libraries_folder() / name
    songs = (
        Song(f"{name}/{Path(file).stem}", partial(read_score, folder / file), **facts)
        for file, facts in read_index(folder / INDEX).items()
    )
    return Library(name, tuple(songs))


def silent(done: int, total: int) -> None:
    """Report no progress."""


@dataclass(frozen=True)
class NewLibrary:
    """A library that is being imported, whose files are written to `folder`."""

    name: str
    folder: Path
    grade: Grade | None = None
    rows: list[tuple[str, Facts]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """A line for each file that could not be read, which says why."""
    doubtful: list[str] = field(default_factory=list)
    """A line for each thing that looks wrong but could be read."""

    def add(self, file: str, score: Score, facts: Facts) -> None:
        """Add a piece to the index, by the name of its file in the folder.

        Length, notes, hands and difficulty come from the score, other facts from `facts`.
        """
        counts = {
            "seconds": round(score.total_time, 2),
            "notes": len(score.notes),
            "hands": _hands(score),
            "difficulty": None if self.grade is None else round(self.grade(score), 2),
        }
        self.rows.append((file, {**facts, **counts}))

    @contextmanager
    def leaving_out_what_is_wrong(self, file: object) -> Iterator[None]:
        """Catch whatever a file causes in the block, and keep a line on it in `left_out`.

        Raises OSError if the disk is full, as it would be for the next piece.
        """
        try:
            yield
        except Exception as error:
            if is_full(error):
                raise
            self.left_out.append(in_a_line(error, file))


@contextmanager
def new_library(
    name: str, replace: bool = False, grade: Grade | None = None
) -> Iterator[NewLibrary]:
    """Yield a library to add pieces to, and save it when the block ends without an error.

    It may `replace` a library of this name. Without a `grade` the difficulty of pieces is unknown.
    Raises CadenzaError if the name is not allowed, there is such a library, nothing has been added,
    or another import is running.
    """
    if not _NAME.fullmatch(name):
        raise CadenzaError(
            f"library name {quoted(name)}: give up to 64 letters, digits, dots, "
            "dashes or underscores"
        )
    all_libraries = _libraries_folder()
    all_libraries.mkdir(parents=True, exist_ok=True)
    with locked_file(all_libraries / ".lock") as ours:
        if not ours:
            raise CadenzaError("another import is running; try again when it has ended")
        if is_imported(name) and not replace:
            raise CadenzaError(
                f"there is a library {name} already; import with --replace to replace it, or "
                "choose another --name"
            )
        for unfinished in all_libraries.glob(f"{TEMPORARY}*"):
            shutil.rmtree(unfinished, ignore_errors=True)
        with new_folder(all_libraries / name, replaces=True) as folder:
            library = NewLibrary(name, folder, grade)
            yield library
            if not library.rows:
                first = "".join(library.left_out[:1])
                raise CadenzaError(f"{name}: not one piece can be read; {first or 'none is there'}")
            write_index(folder / INDEX, library.rows)


def _hands(score: Score) -> int | None:
    """The number of hands, by the fingers or the tracks; None if neither tells."""
    hands = {note.finger.hand for note in score.notes if note.finger}
    return len(hands) or (2 if len(score.tracks) > 1 else None)
