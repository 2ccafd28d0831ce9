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

from cadenza.errors import CadenzaError
from cadenza.music.score import Score

_FOLDER = Path(__file__).parent / "pieces"
_MIDI_SUFFIXES = (".mid", ".midi")


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


def load_score(name_or_path: str | Path, tracks: Collection[int] = ()) -> Score:
    """A bundled piece by its name (upper or lower case), or a MIDI file by its path.

    Whatever is there as a file, or ends in .mid or .midi, is a path; all else is a name.
    Where a file of the same name ending in .fingering lies next to the MIDI file, the notes have
    its fingers, see `cadenza.music.fingering_file`.

    Args:
        name_or_path: the piece or file.
        tracks: numbers of those to be played, as in `Score.tracks`; all where none is given.

    Raises:
        CadenzaError: no such piece or track, or a file that `read_midi` or `read_fingering`
            refuses.
    """
    from cadenza.music.fingering_file import SUFFIX, read_fingering
    from cadenza.music.midi import read_midi

    path = Path(name_or_path)
    if path.suffix.lower() not in _MIDI_SUFFIXES and not os.path.isfile(path):
        path = _FOLDER / f"{_bundled_name(str(name_or_path))}.mid"
    score = read_midi(path, tracks)
    sidecar = path.with_suffix(SUFFIX)
    if not os.path.isfile(sidecar):  # also where that name is too long
        return score
    return read_fingering(sidecar, score, all_there=not tracks)


def _bundled_name(name: str) -> str:
    names = {piece.name.lower(): piece.name for piece in songs()}
    if name.lower() in names:
        return names[name.lower()]
    close = [names[match] for match in get_close_matches(name.lower(), names, cutoff=0.5)]
    hint = f"did you mean {' or '.join(close)}? " if close else ""
    raise CadenzaError(
        f"no song named {name!r}: {hint}run `cadenza songs` for all names, "
        "or give the path of a MIDI file"
    )
