"""`cadenza songs`, `libraries`, `import` and `etude`: what there is to play, and more of it."""

from __future__ import annotations

import warnings
from collections import Counter
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.info import usual_players
from cadenza.cli.progress import progress
from cadenza.cli.saving import check_name, check_writable
from cadenza.errors import CadenzaError, CadenzaWarning, counted
from cadenza.music.etudes import DRILLS, KINDS

if TYPE_CHECKING:
    from cadenza.music.libraries.songs import Library, Song

Sort = Literal["name", "length", "difficulty"]
_LONGEST = 100  # letters of a title or a name in a line


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
    """Return the songs of all libraries once; a library that cannot be read is a warning."""
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
    """Return the sizes of a library's splits as text, such as "; valid 30, train 422"."""
    sizes = Counter(song.split for song in library.songs if song.split)
    return f"; {', '.join(f'{split} {n}' for split, n in sizes.items())}" if sizes else ""


def _line(song: Song, width: int) -> str:
    grade = "" if song.difficulty is None else f"{song.difficulty:.1f}"
    seconds = "" if song.seconds is None else f"{song.seconds:.1f} s"
    by = f" ({song.composer:.{_LONGEST}})" if song.composer else ""
    what = f"{song.title or song.source:.{_LONGEST}}{by}"
    return f"{song.name:{width}} {grade:>4} {seconds:>8}  {what}"


def _last_if_unknown(value: float | None) -> tuple[bool, float]:
    return value is None, value or 0.0


_KEYS: dict[Sort, Any] = {
    "name": lambda song: song.name.lower(),
    "length": lambda song: _last_if_unknown(song.seconds),
    "difficulty": lambda song: _last_if_unknown(song.difficulty),
}


@dataclass(frozen=True)
class Import:
    """Make a song library of a folder of music, or of the PIG dataset.

    Examples: cadenza import midi FOLDER; cadenza import pig PianoFingeringDataset.zip
    """

    kind: Annotated[
        tyro.conf.Positional[Literal["midi", "pig"]], tyro.conf.arg(metavar="{midi,pig}")
    ]
    """midi: a folder of MIDI or MusicXML files, with an index.csv if you like. pig: the PIG
    fingering dataset, for the libraries repertoire-150 and etude-12."""
    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FOLDER")]
    """Where the files are. For the PIG dataset, it may also be the ZIP file."""
    name: str | None = None
    """Name of the new library, for midi; that of the folder by default."""
    replace: tyro.conf.FlagCreatePairsOff[bool] = False
    """Replace a library of the same name."""
    quiet: Quiet = False


def import_songs(command: Import) -> None:
    from cadenza.fingering.difficulty import grade
    from cadenza.music.libraries.folder import import_folder
    from cadenza.music.libraries.library import check_is_free, open_library
    from cadenza.music.libraries.pig import TWELVE, etudes_among, import_pig

    source, again = command.source, command.replace
    if command.kind == "pig" and command.name is not None:
        raise CadenzaError("--name: the PIG dataset has a name; leave it out")
    graded = partial(grade, players=usual_players())
    with progress("importing", "files") as advance:
        if command.kind == "pig":
            library = import_pig(source, again, advance, graded)
        else:
            name = command.name or source.resolve().name
            check_is_free(name)
            library = import_folder(source, name, again, advance, graded)
    for message in (*library.doubtful, *library.left_out):
        warnings.warn(message, CadenzaWarning, stacklevel=1)
    kept, lost = len(library.rows), len(library.left_out)
    print(f"{counted(kept, 'song')}; to list them: cadenza songs {library.name}")
    if command.kind == "pig":
        print(f"{len(etudes_among(open_library(library.name).songs))} of them are in {TWELVE}")
    if lost:
        raise CadenzaError(
            f"{library.name}: {lost} of {kept + lost} could not be read and were left out"
        )


_USUAL_DIFFICULTY = 3


@dataclass(frozen=True)
class Etude:
    """Write a practice piece to a MIDI file, a different one for every seed.

    Example: cadenza etude --kind arpeggios --difficulty 3 --seed 7 -o etude.mid
    """

    kind: Annotated[
        str | None,
        tyro.conf.arg(
            help=f"Kind of piece, by default drawn from {', '.join(KINDS)}. For one hand there are "
            f"also {', '.join(DRILLS)}."
        ),
    ] = None
    difficulty: int | None = None
    """The difficulty from 1 to 10, 3 by default; for one hand, the number of notes or chords."""
    seed: int | None = None
    """Random seed. By default one is drawn and printed."""
    output: Output[Path | None] = None
    """The file, KIND-DIFFICULTY-SEED.mid by default."""


def etude(command: Etude) -> None:
    import numpy as np

    from cadenza.configs import MAX_SEED, whole_number
    from cadenza.music.etudes.library import etude_name, make_etude
    from cadenza.music.formats.midi import write_midi

    if command.output is not None:
        check_name(command.output, ".mid", "an etude is a .mid file")
    seed = int(np.random.default_rng().integers(2**31)) if command.seed is None else command.seed
    rng = np.random.default_rng(whole_number(seed, "seed", 0, MAX_SEED))
    kind = KINDS[int(rng.integers(len(KINDS)))] if command.kind is None else command.kind
    difficulty = _USUAL_DIFFICULTY if command.difficulty is None else command.difficulty
    score = make_etude(kind, difficulty, seed)
    path = command.output or Path(f"{kind}-{difficulty}-{seed}.mid")
    check_writable(path.parent)
    write_midi(score, path)
    print(f"{path}: {score.title} ({score.total_time:.1f} s, {len(score.notes)} notes)")
    print(f"The same without a file: cadenza play {etude_name(kind, difficulty, seed)}")
