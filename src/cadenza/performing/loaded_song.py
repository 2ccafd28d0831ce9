"""Songs as they are loaded: a piece by its name, a music file or a score, with its arrangement."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from pathlib import Path

from cadenza.configs import as_config
from cadenza.errors import CadenzaWarning
from cadenza.music.arrangement import Arrangement
from cadenza.music.libraries.library import find_song
from cadenza.music.libraries.songs import Song
from cadenza.music.score import Score

SomeSong = str | Path | Song | Score


@dataclass(frozen=True)
class LoadedSong:
    """A score, where it comes from, and the part of it that is played."""

    name: str
    """The name of the piece, the path of the file, or the title of a score."""
    score: Score
    arrangement: Arrangement = field(default_factory=Arrangement)
    """The part of the song that the score has."""
    written: Score | None = None
    """The whole song without the expression that its score has, if that has any."""

    def titled(self, title: str) -> LoadedSong:
        """The song under another title."""
        written = self.written and replace(self.written, title=title)
        return replace(self, name=title, score=replace(self.score, title=title), written=written)

    def written_for(self, hands: str) -> LoadedSong:
        """The song with the notes that are written for these hands, see `Arrangement.written_for`.

        Raises CadenzaError if nothing is written for the one hand that plays.
        """
        score = self.arrangement.written_for(hands, self.score)
        written = self.written and self.arrangement.written_for(hands, self.written)
        return replace(self, score=score, written=written)


def load(song: SomeSong | LoadedSong, arrangement: Arrangement | None = None) -> LoadedSong:
    """Load a song, see `load_song`, or a score, which is by default played as it is written.

    What was repaired in it is a warning. Raises CadenzaError if there is no such song, or it cannot
    be read.
    """
    if isinstance(song, LoadedSong):
        return song
    if isinstance(song, Score):
        return LoadedSong(song.title, song, arrangement or Arrangement(arrange="off"))
    song, arrangement = find_song(song), arrangement or Arrangement()
    written = arrangement.whole(song)
    score = arrangement.performed(written, song.name)
    for remark in score.remarks:
        warnings.warn(f"{song.name}: {remark}", CadenzaWarning, stacklevel=3)
    return LoadedSong(song.name, score, arrangement, written if arrangement.expression else None)


def load_song(song: str | Path | Song, arrangement: Arrangement | None = None) -> Score:
    """Load the score of a song; what was repaired in it is a warning.

    Raises CadenzaError if there is no such song, or it cannot be read.

    Args:
        song: the name of a piece, see `cadenza.songs`; the path of a MIDI or MusicXML file; or a
            `Song` of a library.
        arrangement: which notes of it; all by default.
    """
    return load(song, as_config(arrangement, Arrangement)).score
