"""Arrangements of songs. Imports nothing heavy: the command line shows its options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from cadenza.errors import CadenzaError
from cadenza.music.expression_rules import ExpressionRules, check_quantities
from cadenza.music.score import (
    RELEASE_TIME,
    Note,
    Score,
    check_beginning,
    check_length,
    chords,
)

_VOICE_SHARE = 0.9  # of a track's onsets are single notes, if it is a voice
_MIN_SHARE = 0.25  # of the notes of the busiest voice; tracks with fewer only fill in


@dataclass(frozen=True)
class Arrangement:
    """An arrangement says which notes of a song are played, and with how much expression."""

    tracks: tuple[int, ...] = ()
    """Play only these tracks, numbered as in "cadenza info SONG"."""
    reduce: Literal["off", "melody-bass"] = "off"
    """Reduce the song to its highest and its lowest voice."""
    first_seconds: float | None = None
    """Play only what begins within this time from the first note on [s]."""
    expression: float = 0.0
    """The dose of expression: 1 as the KTH rules say, 0 as written."""
    rules: ExpressionRules = field(default_factory=ExpressionRules)
    """The quantity of each rule, which `expression` multiplies."""

    def __post_init__(self) -> None:
        """Checks the options.

        Raises:
            CadenzaError: `first_seconds` is not a positive number, `expression` or a rule is out of
                range, or there are rules but no expression.
        """
        check_quantities(self.expression, self.rules)
        if self.rules != ExpressionRules() and not self.expression:
            raise CadenzaError("rules change nothing without expression: give --expression 1, too")
        if self.first_seconds is not None:
            check_beginning(self.first_seconds)

    def score(self, song: str) -> Score:
        """The arranged score of `song`, a bundled song or a file.

        Raises:
            CadenzaError: it cannot be read, has no such tracks, or lasts over an hour.
        """
        score = self._performed(self._reduced(song))  # whole, as its beginning has no final ritard
        if self.first_seconds is not None:
            score = score.beginning(self.first_seconds)
        music = score.total_time - min((note.start for note in score.notes), default=0.0)
        check_length(music, f"{song}: the song", "; play its beginning with --first-seconds")
        return score

    def _performed(self, score: Score) -> Score:
        if not self.expression:
            return score
        from cadenza.music.expression import performed

        return performed(score, self.expression, self.rules)

    def _reduced(self, song: str) -> Score:
        from cadenza.music.libraries.library import load_score

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
        """Whether anything of a song is left out or changed."""
        return self != Arrangement()


def melody_and_bass_tracks(tracks: Mapping[int, Score]) -> tuple[int, ...]:
    """The numbers of the tracks with the melody and the bass, among more than two `tracks`.

    They have the highest and the lowest mean pitch of those that are voices, one note after the
    other: chords held above a tune are not the tune. All tracks where fewer than two are voices.
    """
    voices = {
        number: score.notes
        for number, score in tracks.items()
        if sum(1 for _ in chords(score.notes)) >= _VOICE_SHARE * len(score.notes)
    }
    busiest = max(map(len, voices.values()), default=0)
    mean_pitch = {
        number: sum(note.pitch for note in notes) / len(notes)
        for number, notes in voices.items()
        if len(notes) >= _MIN_SHARE * busiest
    }
    if len(mean_pitch) < 2:
        return tuple(tracks)
    return max(mean_pitch, key=mean_pitch.__getitem__), min(mean_pitch, key=mean_pitch.__getitem__)


def melody_and_bass(score: Score) -> Score:
    """The highest and the lowest voice of `score`, each monophonic.

    Of the notes that begin together the highest is of the melody, unless a note of either voice
    sounds above it, and the lowest of the bass, unless one sounds below it. In either voice a note
    ends where the next begins. Notes with less than `RELEASE_TIME` left count as over. A note that
    begins alone can be of both.
    """
    kept: list[Note] = []
    voices = {"melody": -1, "bass": -1}  # index in `kept` of their latest notes
    for notes in chords(score.notes):
        time = notes[0].start
        latest = {i for i in voices.values() if i >= 0}
        sounding = [kept[i].pitch for i in latest if kept[i].end > time + RELEASE_TIME]
        high = max(notes, key=lambda note: note.pitch)
        low = min(notes, key=lambda note: note.pitch)
        begin = {}
        if high.pitch >= max(sounding, default=high.pitch):
            begin["melody"] = high
        if low.pitch <= min(sounding, default=low.pitch):
            begin["bass"] = low
        for note in dict.fromkeys(begin.values()):
            kept.append(note)
            voices |= {voice: len(kept) - 1 for voice in begin if begin[voice] is note}
        for i in latest - set(voices.values()):
            kept[i] = replace(kept[i], end=min(kept[i].end, time))
    return replace(score, notes=tuple(kept))
