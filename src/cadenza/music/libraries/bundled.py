"""The pieces that come with Cadenza. To list them, only a small index is read."""

import tomllib
from functools import cache, partial
from pathlib import Path

from cadenza.music.formats.reading import read_score
from cadenza.music.libraries.songs import Library, Song

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
