"""The pieces that come with Cadenza. To list them, only a small index is read."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Literal

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


@dataclass(frozen=True, slots=True)
class Piece:
    """A bundled piece: it lasts `seconds` [s] and is played by one or two `hands`.

    `difficulty` is that for pianists, `grade` that for two robot hands, from 1 to 10 (see
    `cadenza.fingering.difficulty`). `source` names the work, why it is free to use, and who
    arranged and fingered it.
    """

    name: str
    title: str
    composer: str
    source: str = field(repr=False)
    difficulty: Literal["easy", "intermediate", "hard"]
    grade: float
    seconds: float
    hands: int


@cache
def songs() -> tuple[Piece, ...]:
    """The bundled pieces, from easy to hard."""
    index = tomllib.loads((_FOLDER / "index.toml").read_text(encoding="utf-8"))
    return tuple(Piece(name, **about) for name, about in index.items())


def bundled() -> Library:
    """The library of all bundled pieces, from easy to hard; songs are named without the library."""
    return Library("bundled", tuple(map(_song, songs())))


def debug() -> Library:
    """The library of short bundled pieces, for quick experiments."""
    return Library("debug", tuple(_song(piece) for piece in songs() if piece.name in _SHORT))


def _song(piece: Piece) -> Song:
    return Song(
        piece.name,
        partial(read_score, _FOLDER / f"{piece.name}.mid"),
        title=piece.title,
        composer=piece.composer,
        source=piece.source,
        seconds=piece.seconds,
        hands=piece.hands,
        difficulty=piece.grade,
    )
