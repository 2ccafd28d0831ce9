"""The bundled pieces, and how to load any score.

Listing the pieces reads one small index; MIDI is imported only when a score is loaded, because
the names are wanted whenever Cadenza starts.
"""

from __future__ import annotations

import os.path
import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Literal

from cadenza.errors import CadenzaError, by_others
from cadenza.music.score import Score
from cadenza.registry import Registry

_FOLDER = Path(__file__).parent / "pieces"
_MIDI = (".mid", ".midi")
_MUSICXML = (".musicxml", ".xml", ".mxl")
_NOTATION = "open it in a notation program such as MuseScore, and export it as MIDI or MusicXML"
_SOUND = "convert the sound to MIDI with a transcription program such as Basic Pitch"
_SHEET = "convert the sheet music to MusicXML with a recognition program such as Audiveris"
_NOT_READ = {  # what to do about formats that some may hold for music
    **dict.fromkeys((".mscz", ".mscx", ".sib", ".musx", ".dorico", ".ptb", ".mei"), _NOTATION),
    **dict.fromkeys((".gp", ".gp3", ".gp4", ".gp5", ".gpx", ".cap", ".capx"), _NOTATION),
    **dict.fromkeys((".abc",), "convert it with abc2midi"),
    **dict.fromkeys((".ly",), "have LilyPond write MIDI: add \\midi {} to its \\score block"),
    **dict.fromkeys((".krn",), "convert it with hum2mid, or with Verovio"),
    **dict.fromkeys((".mp3", ".wav", ".flac", ".ogg", ".m4a", ".aac", ".opus", ".mp4"), _SOUND),
    **dict.fromkeys((".pdf", ".png", ".jpg", ".jpeg", ".tif", ".tiff"), _SHEET),
}


@dataclass(frozen=True, slots=True)
class Piece:
    """A bundled piece: it lasts `seconds` [s] and is played by one or two `hands`.

    `source` names the work, why it is free to use, and who arranged and fingered it.
    """

    name: str
    title: str
    composer: str
    source: str
    difficulty: Literal["easy", "intermediate", "hard"]
    seconds: float
    hands: int


@cache
def songs() -> tuple[Piece, ...]:
    """The bundled pieces, from easy to hard."""
    index = tomllib.loads((_FOLDER / "index.toml").read_text(encoding="utf-8"))
    return tuple(Piece(name, **about) for name, about in index.items())


LIBRARIES = Registry("song library", "cadenza.songs")
"""Folders of songs that other packages add: a path, or a function that returns one."""


def library(name: str) -> dict[str, Path]:
    """The songs of a library of another package in alphabetical order: name -> file.

    Raises:
        CadenzaError: there is no such library, or it is no folder.
    """
    place = LIBRARIES.load(name, object)
    with by_others(f"song library {name}"):
        place = place() if callable(place) else place
    if not isinstance(place, str | Path) or not os.path.isdir(place):
        raise CadenzaError(f"song library {name}: {place!r:.100} is not a folder")
    files = sorted(Path(place).iterdir())
    return {file.stem: file for file in files if file.suffix.lower() in (*_MIDI, *_MUSICXML)}


def load_score(name_or_path: str | Path, tracks: Collection[int] = ()) -> Score:
    """A piece by its name (upper or lower case), or a file of MIDI or MusicXML by its path.

    Pieces of a library that another package adds are called `library/piece`.

    Whatever is there as a file, or ends as a file of music does, is a path; all else is a name.
    Where a file of the same name ending in .fingering lies next to the file, the notes have its
    fingers, see `cadenza.music.fingering_file`.

    Args:
        name_or_path: the piece or file.
        tracks: numbers of those to be played, as in `Score.tracks`; all where none is given.

    Raises:
        CadenzaError: no such piece or track, a format that is not read, or a file that
            `read_midi`, `read_musicxml` or `read_fingering` refuses.
    """
    from cadenza.music.fingering_file import SUFFIX, read_fingering
    from cadenza.music.midi import read_midi
    from cadenza.music.musicxml import read_musicxml

    check_is_name(name_or_path)
    path = Path(name_or_path)
    suffix = path.suffix.lower()
    if suffix not in (*_MIDI, *_MUSICXML, *_NOT_READ) and not os.path.isfile(path):
        path = _file_of(str(name_or_path))
    if suffix in _NOT_READ:
        raise CadenzaError(f"{path}: {suffix} files cannot be read; {_NOT_READ[suffix]}")
    score = (read_musicxml if suffix in _MUSICXML else read_midi)(path, tracks)
    sidecar = path.with_suffix(SUFFIX)
    if not os.path.isfile(sidecar):  # also where that name is too long
        return score
    return read_fingering(sidecar, score, all_there=not tracks)


def check_is_name(song: object) -> None:
    """Raises: CadenzaError: it is nothing that names a song."""
    if not isinstance(song, str | Path):
        raise CadenzaError(
            f"song {song!r:.100}: give the name of a bundled song, the path of a MIDI or MusicXML "
            "file, or a Score"
        )


def _file_of(name: str) -> Path:
    """Of a bundled song, or of one of a library."""
    prefix, _, song = name.partition("/")
    if song and prefix in LIBRARIES.entries():
        files = {f"{prefix}/{song}": file for song, file in library(prefix).items()}
    else:
        files = {piece.name: _FOLDER / f"{piece.name}.mid" for piece in songs()}
    names = {known.lower(): known for known in files}
    if name.lower() in names:
        return files[names[name.lower()]]
    close = [names[match] for match in get_close_matches(name.lower(), names, cutoff=0.5)]
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    raise CadenzaError(
        f"no song named {name!r}: {hint}run `cadenza songs` for all names, "
        "or give the path of a MIDI or MusicXML file"
    )
