"""Song libraries and songs by name, and the scores of songs.

A listing reads only an index. Readers of music files are imported when a score is loaded, because
the names are needed whenever Cadenza starts.
"""

import os.path
from collections.abc import Collection
from dataclasses import replace
from difflib import get_close_matches
from functools import partial
from pathlib import Path

from cadenza.errors import CadenzaError, by_others, quoted
from cadenza.hub import is_on_hub
from cadenza.music.formats.reading import MUSIC, NOT_READ, read_score
from cadenza.music.libraries.folder import folder_library
from cadenza.music.libraries.imported import imported, imported_libraries, is_imported
from cadenza.music.libraries.songs import Library, Song, bundled, song_named, songs
from cadenza.music.score import Score
from cadenza.registry import Entry, Registry

__all__ = ["LIBRARIES", "find_song", "libraries", "load_score", "open_library", "songs"]

ETUDES = "etudes"
_WEB = ("http:/", "https:/", "ftp:/", "file:/")  # of addresses, also as paths
LIBRARIES = Registry(
    "song library",
    "cadenza.songs",
    {
        "benchmark": Entry(
            "cadenza.music.libraries.benchmark:benchmark_sets", "etudes and songs of the benchmark"
        ),
        "bundled": Entry(
            "cadenza.music.libraries.songs:bundled", "the pieces that come with Cadenza"
        ),
        "debug": Entry("cadenza.music.libraries.songs:debug", "six of them that are short"),
        "etude-12": Entry("cadenza.music.libraries.pig:etude_12", "the twelve published etudes"),
        ETUDES: Entry(
            "cadenza.music.etudes.library:etude_library", "etudes:N has N practice pieces"
        ),
        "repertoire-150": Entry("cadenza.music.libraries.pig:repertoire_150", "the PIG dataset"),
    },
    otherwise="a folder",
)
"""The names of libraries that need no import. Each stands for a library, for a folder of songs, as
other packages add them, or for a function that returns either."""


def libraries() -> dict[str, str]:
    """Name -> description of every library."""
    registered = {name: entry.about for name, entry in LIBRARIES.entries().items()}
    imported = {name: "imported" for name in imported_libraries() if name not in registered}
    return {**registered, **imported}


def distinct_libraries() -> list[str]:
    """The names of finite libraries that have no song in common."""
    added = [name for name in LIBRARIES.entries() if name not in LIBRARIES.own]
    return list(dict.fromkeys(["bundled", *imported_libraries(), *added]))


def open_library(spec: str | Path) -> Library:
    """The library of a name or a folder; only an index is read.

    Raises CadenzaError if there is no such library or split, it has not been imported yet, or its
    index is damaged.

    Args:
        spec: the name of a library, see `libraries`, that of a song or the path of a music file,
            which is then all of the library, or the path of a folder of MIDI or MusicXML files,
            which may have an index (see `cadenza.music.libraries.index`). With `:SPLIT`
            after it, only the songs of that split, as in "repertoire:valid". `etudes:N` are N
            etudes, drawn from the seed 0 or from that of `etudes:N:SEED`. A folder that has the
            same name as a library wants a path with a separator, such as "./bundled".
    """
    text = str(spec)
    name, colon, split = text.partition(":")
    if text.startswith(f"{ETUDES}:"):
        from cadenza.music.etudes.library import etude_library

        return etude_library(split)
    if not isinstance(spec, Path) and _is_library(name):
        library = _named(name)
    elif os.path.isdir(text):
        library, colon = folder_library(Path(text)), ""
    elif os.path.isdir(path := text.rpartition(":")[0]):
        library, split = folder_library(Path(path)), text[len(path) + 1 :]
    elif os.path.isfile(text) or _is_bundled(text) or _is_library(text.partition("/")[0]):
        library, colon = Library(text, (find_song(text),)), ""
    else:
        close = get_close_matches(name, list(libraries()), n=1)
        hint = f"did you mean {close[0]}? " if close else ""
        hint = "give one song, or a folder of several; " if "," in text else hint
        raise CadenzaError(
            f"no song library {quoted(text)}: {hint}run `cadenza libraries` for all "
            "names, or give the "
            "path of a folder"
        )
    return library.of_split(split) if colon else library


def find_song(song: str | Path | Song) -> Song:
    """The song of a name, in upper or lower case, or of the path of a MIDI or MusicXML file.

    A `Song` is returned as it is.

    Bundled pieces are called by their names, those of other libraries `library/piece`. A word is a
    path if there is such a file, or if it has the ending of a music file. Notes have the fingers of
    a file beside it with the ending .fingering, see `cadenza.music.formats.fingering_file`. Raises
    CadenzaError if there is no such song.
    """
    if isinstance(song, Song):
        return song
    if not isinstance(song, str | Path):
        raise CadenzaError(
            f"song {quoted(song)}: give the name of a piece, the path of a MIDI or MusicXML file, "
            "a Song or a Score"
        )
    path, name = Path(song), str(song)
    if name.startswith(_WEB):
        raise CadenzaError(f"{name}: is an address; download the file, and give its path")
    if path.suffix.lower() in (*MUSIC, *NOT_READ) or os.path.isfile(path):
        return Song(name, partial(read_score, path))
    library, _, piece = name.partition("/")
    if library == ETUDES and piece:
        from cadenza.music.etudes.library import etude_song

        return etude_song(name)
    if piece and _is_library(library):
        return song_named(name, _named(library))
    if not _is_bundled(name) and (os.path.isdir(name) or is_on_hub(name)):
        raise CadenzaError(
            f"{name}: is no song; give a piece or a music file (what has learnt or practised one "
            f"plays it as --agent {name})"
        )
    return song_named(name, bundled())


def load_score(song: str | Path | Song, tracks: Collection[int] = (), plain: bool = False) -> Score:
    """The score of a song or file, see `find_song` and `Song.load`.

    Raises CadenzaError if there is no such song or track, or `read_score` refuses its file.
    """
    return find_song(song).load(tracks, plain)


def check_is_free(name: str) -> None:
    """Check that an imported library may have a name; raises CadenzaError if that is taken."""
    if name in (entries := LIBRARIES.entries()):
        raise CadenzaError(
            f"there is a library {name} already ({entries[name].about}); choose another --name"
        )


def _is_bundled(name: str) -> bool:
    return any(song.name.lower() == name.lower() for song in songs())


def _is_library(name: str) -> bool:
    return name in LIBRARIES.own or is_imported(name) or name in LIBRARIES.entries()


def _named(name: str) -> Library:
    """The library of this name; raises CadenzaError if it is not imported, none, or damaged."""
    if is_imported(name):
        return imported(name)
    about = LIBRARIES.entries()[name].about
    place = LIBRARIES.load(name, object)
    with by_others(f"song library {name}"):
        place = place() if callable(place) else place
    if isinstance(place, Library):
        return place
    if not isinstance(place, str | Path) or not os.path.isdir(place):
        raise CadenzaError(f"song library {name}: {quoted(place)} is not a folder")
    songs = folder_library(Path(place), name).songs
    return Library(name, tuple(replace(song, source=song.source or about) for song in songs))
