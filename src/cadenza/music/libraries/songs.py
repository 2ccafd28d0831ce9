"""Songs with what listings say of them, libraries of songs, and those that come with Cadenza.

No music file is opened here; to list the bundled pieces, only a small index is read.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache, partial
from pathlib import Path

from cadenza.errors import CadenzaError, quoted
from cadenza.music.formats.reading import read_score
from cadenza.music.score import Score
from cadenza.music.written_hands import with_written_hands

Read = Callable[[Collection[int], bool], Score]
"""A function that loads a score with the tracks of these numbers, or with all if none is given.

It plays notes as they stand, whatever signs they have, if the second argument is true."""

_MAX_SUGGESTIONS = 3  # songs that a misspelt name may mean


@dataclass(frozen=True, slots=True)
class Song:
    """A song that can be loaded; unknown facts are empty or None.

    `cadenza play` takes the `name`. The song lasts `seconds` [s] and has a number of `notes`, for
    one or two `hands`; `difficulty` is its grade from 1 to 10; `source` says where it is from,
    and `split` names the split of its library, such as "train".
    """

    name: str
    read: Read = field(repr=False, compare=False)
    title: str = ""
    composer: str = ""
    source: str = field(default="", repr=False)
    split: str = ""
    seconds: float | None = None
    notes: int | None = None
    hands: int | None = None
    difficulty: float | None = None

    def load(self, tracks: Collection[int] = (), plain: bool = False) -> Score:
        """Load the score, with the title and the composer of the song, and its written hands.

        See `read_score`. Raises CadenzaError if it cannot be read, or has no such track.
        """
        score = with_written_hands(self.read(tracks, plain))
        composer = self.composer or score.composer
        return replace(score, title=self.title or score.title, composer=composer)


@dataclass(frozen=True, slots=True)
class Library:
    """Songs under one name."""

    name: str
    songs: tuple[Song, ...]

    def __repr__(self) -> str:
        return f"Library({self.name!r}, {len(self.songs)} songs)"

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits of the library, in alphabetical order."""
        return tuple(sorted({song.split for song in self.songs} - {""}))

    def of_split(self, split: str) -> Library:
        """The songs of one split. Raises CadenzaError if there is no such split."""
        songs = tuple(song for song in self.songs if song.split == split)
        if not split or not songs:
            advice = f"choose from {', '.join(self.splits)}" if self.splits else "it has none"
            raise CadenzaError(f"{self.name}: there is no split {quoted(split)}; {advice}")
        return Library(f"{self.name}:{split}", songs)


def song_named(name: str, library: Library) -> Song:
    """The song of a library with this name, in any case; raises CadenzaError if there is none."""
    names = {song.name.lower(): song for song in library.songs}
    # Bundled songs are called by their names alone, and found with the name of the library, too.
    for candidate in (name.lower(), name.lower().removeprefix(f"{library.name}/")):
        if candidate in names:
            return names[candidate]
    completions = [full_name for full_name in names if name and full_name.startswith(name.lower())]
    close = completions[:_MAX_SUGGESTIONS] or get_close_matches(
        name.lower(), names, _MAX_SUGGESTIONS, cutoff=0.5
    )
    hint = (
        f"did you mean {' or '.join(names[full_name].name for full_name in close)}? "
        if close
        else ""
    )
    raise CadenzaError(
        f"no song named {quoted(name)}: {hint}run `cadenza songs` for all names, "
        "or give the path of a MIDI or MusicXML file"
    )


_FOLDER = Path(__file__).parent / "pieces"
_SHORT = (  # pieces that the published system has, too
    "TwinkleTwinkleLittleStar",
    "CMajorScaleOneHand",
    "DMajorScaleOneHand",
    "CMajorScaleTwoHands",
    "DMajorScaleTwoHands",
    "CMajorChordProgressionTwoHands",
)


@cache
def songs() -> tuple[Song, ...]:
    """The bundled pieces, from easy to hard for pianists."""
    index = tomllib.loads((_FOLDER / "index.toml").read_text(encoding="utf-8"))
    return tuple(
        Song(
            name,
            partial(read_score, _FOLDER / f"{name}.mid"),
            title=about["title"],
            composer=about["composer"],
            source=about["source"],
            seconds=about["seconds"],
            hands=about["hands"],
            difficulty=about["grade"],
        )
        for name, about in index.items()
    )


def bundled() -> Library:
    """The library of all bundled pieces, from easy to hard; songs are named without the library."""
    return Library("bundled", songs())


def debug() -> Library:
    """The library of short bundled pieces, for quick experiments."""
    return Library("debug", tuple(piece for piece in songs() if piece.name in _SHORT))
