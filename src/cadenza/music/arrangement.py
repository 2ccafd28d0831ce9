"""Which notes of a song are played. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cadenza.music.score import Score


@dataclass(frozen=True)
class Arrangement:
    """Which notes of a song are played."""

    tracks: tuple[int, ...] = ()
    """Play only these tracks, numbered as in "cadenza info SONG"."""
    reduce: Literal["off", "melody-bass"] = "off"
    """Reduce the song to its highest and lowest voice."""

    def score(self, song: str) -> Score:
        """The bundled song or the file `song`, so arranged.

        Raises:
            CadenzaError: it cannot be read, or has no such tracks.
        """
        from cadenza.music.library import load_score
        from cadenza.music.reduction import melody_and_bass

        score = load_score(song, self.tracks)
        return melody_and_bass(score) if self.reduce == "melody-bass" else score

    @property
    def chosen(self) -> bool:
        """Whether anything is left out on purpose."""
        return self != Arrangement()
