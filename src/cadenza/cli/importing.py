"""`cadenza import`: a song library made of files."""

import warnings
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cadenza.cli.arguments import Quiet
from cadenza.cli.info import usual_players
from cadenza.cli.printing import progress
from cadenza.errors import CadenzaError, CadenzaWarning, counted


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


def run(command: Import) -> None:
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
