"""Drums that accent what is played with them."""

from __future__ import annotations

from cadenza.music.accents import accented
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import Note, Score

BASS_DRUM, CLOSED_HAT = 36, 42


def velocities(score: Score) -> list[int]:
    return [note.velocity for note in score.notes]


def test_what_is_struck_with_a_bass_drum_is_louder() -> None:
    notes = tuple(Note(0.5 * i, 0.5 * i + 0.4, 60, 80) for i in range(4))
    drums = (
        Note(0.01, 0.1, BASS_DRUM, 127),
        Note(0.5, 0.6, CLOSED_HAT, 127),
        Note(1.0, 1.1, BASS_DRUM, 64),
    )
    assert velocities(accented(Score(notes, drums=drums))) == [96, 80, 88, 80]


def test_nothing_is_louder_than_midi_has_it_or_without_drums() -> None:
    loud = Score((Note(0.0, 1.0, 60, 120),))
    assert accented(loud) == loud
    drums = (Note(0.0, 0.1, BASS_DRUM, 127),)
    assert velocities(accented(Score(loud.notes, drums=drums))) == [127]


def test_drums_are_an_option_of_the_arrangement_and_off_by_default() -> None:
    plain = Arrangement().score("benchmark/band-1007")
    louder = Arrangement(drums="accents").score("benchmark/band-1007")
    assert [n.pitch for n in plain.notes] == [n.pitch for n in louder.notes]
    added = [b - a for a, b in zip(velocities(plain), velocities(louder), strict=True)]
    assert min(added) == 0 < max(added) <= 16
