"""Arrangements of songs. Imports nothing heavy: the command line shows its options."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from cadenza.configs import whole_number
from cadenza.errors import CadenzaError
from cadenza.fingers import SIDES
from cadenza.music.expression_rules import ExpressionRules, check_quantities
from cadenza.music.score import Score, check_beginning, check_length

if TYPE_CHECKING:
    from cadenza.music.libraries.songs import Song

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
        check_quantities(self.expression, self.rules)
        if self.rules != ExpressionRules() and not self.expression:
            raise CadenzaError("rules change nothing without expression: give --expression 1, too")
        if self.first_seconds is not None:
            check_beginning(self.first_seconds)

    def score(self, song: str) -> Score:
        """The score of `song`, a bundled song or a file, before it is arranged for any hands.

        Raises CadenzaError if it cannot be read, has no such tracks, or lasts over an hour.
        """
        from cadenza.music.libraries.library import find_song

        return self.performed(self.whole(find_song(song)), song)

    def whole(self, song: Song) -> Score:
        """The whole score of `song`; raises CadenzaError if it or its tracks cannot be read."""
        return song.load(self.tracks, self.plain)

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

    def written_for(self, hands: str, score: Score) -> Score:
        """The notes of a song that are written for the hands that play: "right", "left" or both.

        All are left with `all_notes`, for both hands, and where the song does not say. Raises
        CadenzaError if nothing is written for the one hand that plays.
        """
        if hands not in SIDES or self.all_notes or not score.has_written_hands:
            return score
        hand = SIDES.index(hands)
        notes = tuple(note for note in score.notes if hand in note.hands)
        if not notes:
            raise CadenzaError(
                f"{score.title}: nothing is written for the {hands} hand; choose the other one, or "
                "--all-notes to have it play what is written for the other"
            )
        return replace(score, notes=notes)

    @property
    def asks_for_hands(self) -> bool:
        """Whether the song is to be arranged for the hands even if they can play it as written."""
        return self.arrange == "always" or self.level is not None

    @property
    def chosen(self) -> bool:
        """Whether anything of a song is left out or changed."""
        return self != Arrangement()
