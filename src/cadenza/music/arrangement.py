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
    """Reduce the song to its melody and its bass: the highest and the lowest voice."""
    first_seconds: float | None = None
    """Play only what begins within this time from the first note on [s]."""

    def __post_init__(self) -> None:
        """Raises: CadenzaError: `first_seconds` is not a positive number."""
        if self.first_seconds is not None:
            from cadenza.music.score import check_beginning

            check_beginning(self.first_seconds)

    def score(self, song: str) -> Score:
        """The bundled song or the file `song`, so arranged.

        Raises:
            CadenzaError: it cannot be read, has no such tracks, or lasts over an hour.
        """
        from cadenza.music.score import check_length

        score = self._reduced(song)
        if self.first_seconds is not None:
            score = score.beginning(self.first_seconds)
        music = score.total_time - min((note.start for note in score.notes), default=0.0)
        check_length(music, f"{song}: the song", "; play its beginning with --first-seconds")
        return score

    def _reduced(self, song: str) -> Score:
        from cadenza.music.libraries.library import load_score
        from cadenza.music.reduction import melody_and_bass, melody_and_bass_tracks

        score = load_score(song, self.tracks)
        if self.reduce == "off":
            return score
        numbers = self.tracks or tuple(track.number for track in score.tracks)
        if len(numbers) > 2:
            parts = {number: load_score(song, (number,)) for number in numbers}
            score = load_score(song, melody_and_bass_tracks(parts))
        return melody_and_bass(score)

    @property
    def chosen(self) -> bool:
        """Whether anything is left out on purpose."""
        return self != Arrangement()
