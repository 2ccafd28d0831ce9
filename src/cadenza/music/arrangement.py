"""Songs as they are played: which notes of them, and with how much expression.

The command line shows the options, so that nothing heavy is imported.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Literal

from cadenza.configs import as_config, check_ranges, whole_number
from cadenza.errors import CadenzaError, FileWarning
from cadenza.fingers import SIDES
from cadenza.music.expression_rules import MAX_QUANTITY, ExpressionRules
from cadenza.music.libraries.songs import Song
from cadenza.music.score import Score, check_beginning, check_length

EASIEST, HARDEST = 1, 10  # the grades of difficulty


@dataclass(frozen=True)
class Arrangement:
    """An arrangement says which notes of a song are played, and with how much expression."""

    tracks: tuple[int, ...] = ()
    """Play only these tracks, numbered as in "cadenza info SONG"."""
    plain: bool = False
    """Play the notes as they stand, without signs."""
    arrange: Literal["auto", "always", "off"] = "auto"
    """Arrange the song for the hands: auto where they cannot play it as written."""
    level: int | None = None
    """Arrange the song to a difficulty from 1 to 10."""
    all_notes: bool = False
    """Have one hand play all notes, also what is written for the other."""
    first_seconds: float | None = None
    """Play only what begins within this time from the first note on [s]."""
    expression: float = 0.0
    """The dose of expression: 1 as the KTH rules say, 0 as written."""
    rules: ExpressionRules = field(default_factory=ExpressionRules)
    """The quantity of each rule, which `expression` multiplies."""

    def __post_init__(self) -> None:
        """Check the options.

        Raises CadenzaError if `first_seconds` is not a positive number, `level`, `expression` or a
        rule is out of range, there are rules but no expression, or a level but nothing is arranged.
        """
        if self.level is not None:
            whole_number(self.level, "level", EASIEST, HARDEST)
            if self.arrange == "off":
                raise CadenzaError("as written, a song has no level: leave out arrange or level")
        if not 0 <= self.expression <= MAX_QUANTITY:
            raise CadenzaError(f"expression {self.expression}: choose 0 to {MAX_QUANTITY}")
        quantities = {each.name: (0, MAX_QUANTITY) for each in fields(self.rules)}
        check_ranges(self.rules, quantities, "rules.")
        if self.rules != ExpressionRules() and not self.expression:
            raise CadenzaError("rules change nothing without expression: give --expression 1, too")
        if self.first_seconds is not None:
            check_beginning(self.first_seconds)

    def performed(self, score: Score, song: str) -> Score:
        """The part of a whole score that is played, with expression.

        Raises CadenzaError if it lasts over an hour; the message begins with `song`.
        """
        if self.expression:  # before it is cut, as its beginning has no final ritard
            from cadenza.music.expression import performed

            score = performed(score, self.expression, self.rules)
        if self.first_seconds is not None:
            score = score.beginning(self.first_seconds)
        music = score.total_time - min((note.start for note in score.notes), default=0.0)
        check_length(music, f"{song}: the song", "; play its beginning with --first-seconds")
        return score

    @property
    def asks_for_hands(self) -> bool:
        """Whether the song is to be arranged for the hands even if they can play it as written."""
        return self.arrange == "always" or self.level is not None

    @property
    def chosen(self) -> bool:
        """Whether anything of a song is left out or changed."""
        return self != Arrangement()


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
        """The song with the notes that are written for these hands: "right", "left" or both.

        All are left for both hands, with `Arrangement.all_notes`, and where the song does not say.
        Raises CadenzaError if nothing is written for the one hand that plays.
        """
        if hands not in SIDES or self.arrangement.all_notes or not self.score.has_written_hands:
            return self
        hand = SIDES.index(hands)

        def own(score: Score) -> Score:
            return replace(score, notes=tuple(n for n in score.notes if hand in n.hands))

        score = own(self.score)
        if not score.notes:
            raise CadenzaError(
                f"{score.title}: nothing is written for the {hands} hand; choose the other one, or "
                "--all-notes to have it play what is written for the other"
            )
        return replace(self, score=score, written=self.written and own(self.written))


def load(song: SomeSong | LoadedSong, arrangement: Arrangement | None = None) -> LoadedSong:
    """Load a song, see `load_song`, or a score, which is by default played as it is written.

    What was repaired in it is a warning. Raises CadenzaError if there is no such song, it cannot be
    read, has no such tracks, or lasts over an hour.
    """
    from cadenza.music.libraries.library import find_song

    if isinstance(song, LoadedSong):
        return song
    if isinstance(song, Score):
        return LoadedSong(song.title, song, arrangement or Arrangement(arrange="off"))
    song, arrangement = find_song(song), arrangement or Arrangement()
    written = song.load(arrangement.tracks, arrangement.plain)
    score = arrangement.performed(written, song.name)
    for remark in score.remarks:
        warnings.warn(f"{song.name}: {remark}", FileWarning, stacklevel=3)
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
