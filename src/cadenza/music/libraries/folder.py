"""Song libraries from folders of music files."""

import os
import re
import shutil
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from cadenza.errors import CadenzaError, quoted
from cadenza.files import files_in
from cadenza.music.formats.fingering_file import SUFFIX
from cadenza.music.formats.reading import MUSIC, read_score
from cadenza.music.formats.source import printable
from cadenza.music.libraries.imported import Grade, NewLibrary, Progress, new_library, silent
from cadenza.music.libraries.index import INDEX, Facts, read_index
from cadenza.music.libraries.songs import Library, Song
from cadenza.music.score import check_length

_LONGEST = 120  # bytes of the name of a piece


def folder_library(folder: Path, name: str = "") -> Library:
    """The library of the music files in a folder and the folders in it; none of them is opened.

    The folder may have an index, see `cadenza.music.libraries.index`. Songs are called `name/piece`
    or, without a name, by their paths. Raises CadenzaError if there are no music files, or the
    index cannot be read.
    """
    files = music_files(folder)
    if not files:
        raise CadenzaError(f"{folder}: there is no file of music in it ({', '.join(MUSIC)})")
    names = unique(file.stem for file in files)
    facts_of_files = _facts(files, index_of(folder))
    songs = (
        Song(
            f"{name}/{piece}" if name else str(folder / file),
            partial(read_score, folder / file),
            **facts,
        )
        for piece, file, facts in zip(names, files, facts_of_files, strict=True)
    )
    return Library(name or str(folder), tuple(songs))


def import_folder(
    folder: Path,
    name: str,
    replace: bool = False,
    progress: Progress = silent,
    grade: Grade | None = None,
) -> NewLibrary:
    """Copy the music files in a folder, and the facts of its index, to a library of the user's.

    Files that cannot be read are left out.

    `progress` is called with the number of files read, and of all; the rest is as in
    `folder_library` and `new_library`. Raises CadenzaError if nothing can be read, the index is
    damaged, or there is such a library.
    """
    if not os.path.isdir(folder):
        raise CadenzaError(f"{folder}: there is no such folder")
    files, index = music_files(folder), index_of(folder)
    pieces = list(zip(files, _safe_names(files), _facts(files, index), strict=True))
    with new_library(name, replace, grade) as library:
        for done, (file, piece, facts) in enumerate(pieces):
            progress(done, len(files))
            with library.leaving_out_what_is_wrong(folder / file):
                score = read_score(folder / file)
                check_length(score.total_time, f"{folder / file}: the song")
                copy = library.folder / f"{piece}{file.suffix.lower()}"
                shutil.copyfile(folder / file, copy)
                if os.path.isfile(fingers := (folder / file).with_suffix(SUFFIX)):
                    shutil.copyfile(fingers, copy.with_suffix(SUFFIX))
                library.add(copy.name, score, {**facts, "title": facts.get("title") or score.title})
        known = {name for file in files for name in (*_paths(file), *_names(file))}
        library.left_out.extend(
            f"{folder / INDEX}: there is no file of music {quoted(name)}"
            for name in index
            if name not in known
        )
    return library


def _safe_names(files: Sequence[Path]) -> list[str]:
    """A name for each file that any file system, shell and terminal takes.

    Where several files in different folders have the same name, those of the folders precede it.
    """
    stems = Counter(file.stem.casefold() for file in files)
    return unique(
        _safe(file.stem if stems[file.stem.casefold()] == 1 else str(file.with_suffix("")))
        for file in files
    )


def _safe(name: str) -> str:
    """The name in letters, digits, dashes and underscores only, and shortened."""
    safe = re.sub(r"[^\w-]+", "-", unicodedata.normalize("NFC", printable(name))).strip("-")
    return short(safe) or "song"


def short(name: str) -> str:
    """The beginning of a name, with room in a file name for a number and an ending."""
    return name.encode()[:_LONGEST].decode(errors="ignore")


def music_files(folder: Path) -> list[Path]:
    """The paths of music files within a folder, in alphabetical order, without hidden ones."""
    return sorted(path for path in files_in(folder) if path.suffix.lower() in MUSIC)


def index_of(folder: Path) -> dict[str, Facts]:
    """The facts in the index of a folder, if it has any; raises CadenzaError if it is damaged."""
    return read_index(folder / INDEX) if os.path.isfile(folder / INDEX) else {}


def _facts(files: Sequence[Path], index: Mapping[str, Facts]) -> Iterator[Facts]:
    """Yield the facts about each file. A name that is the path of a file means no other file."""
    paths = {path for file in files for path in _paths(file)}
    for file in files:
        names = [*_paths(file), *(name for name in _names(file) if name not in paths)]
        yield next((index[name] for name in names if name in index), {})


def _paths(file: Path) -> tuple[str, str]:
    """The path of a file with its ending and without."""
    return file.as_posix(), file.with_suffix("").as_posix()


def _names(file: Path) -> tuple[str, str]:
    return file.name, file.stem


def unique(names: Iterable[str]) -> list[str]:
    """The names, with a number behind each that was there before in upper or lower case."""
    used: set[str] = set()
    numbers: Counter[str] = Counter()
    result = []
    for name in names:
        new = name
        while new.casefold() in used:
            numbers[name] += 1
            new = f"{name}-{numbers[name] + 1}"
        used.add(new.casefold())
        result.append(new)
    return result
