"""Songs for a band: that the file has them, that roles are true, and that they are music."""

from __future__ import annotations

import hashlib
from functools import cache
from itertools import pairwise
from pathlib import Path

import mido
import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.music.etudes.band import ROLES, Band, BandPart, make_band, write_band
from cadenza.music.formats.general_midi import INSTRUMENTS
from cadenza.music.formats.midi import read_midi
from cadenza.music.libraries.library import load_score, open_library
from cadenza.music.score import PITCHES, Note

SEEDS = range(30)
JITTER = 0.012  # [s] a note is early or late at most, and half a tick
few = pytest.mark.parametrize("seed", range(8))


@cache
def bands() -> tuple[Band, ...]:
    return tuple(map(make_band, SEEDS))


def pitched(band: Band) -> list[BandPart]:
    return [part for part in band.parts if part.channel != 10]


def sounding(band: Band, start: float, end: float) -> set[int]:
    """The pitch classes of the accompaniment and the bass within a time."""
    notes = (*band.notes("harmony"), *band.notes("bass"))
    return {note.pitch % 12 for note in notes if note.start < end and note.end > start}


def share(found: list[bool]) -> float:
    return sum(found) / len(found)


# The file


def test_the_same_seed_gives_the_same_file(tmp_path: Path) -> None:
    files = []
    for i, seed in enumerate((3, 3, 4)):
        write_band(make_band(seed), path := tmp_path / f"{i}.mid")
        files.append(path.read_bytes())
    assert files[0] == files[1] != files[2]


def test_songs_are_the_same_on_every_machine(tmp_path: Path) -> None:
    """What is measured with them names them by their seeds only."""
    digest = hashlib.sha256()
    for band in bands()[:8]:
        write_band(band, tmp_path / "song.mid")
        digest.update((tmp_path / "song.mid").read_bytes())
    assert digest.hexdigest()[:16] == "4c38d309c095e02e"


@few
def test_the_file_has_the_tracks(seed: int, tmp_path: Path) -> None:
    band = bands()[seed]
    write_band(band, path := tmp_path / "song.mid")
    score = read_midi(path)
    assert score.title == band.title
    assert [(t.name, t.instrument, t.channel, t.notes) for t in score.tracks] == [
        (p.name, INSTRUMENTS[p.program], p.channel, len(p.notes)) for p in pitched(band)
    ]
    for number, part in enumerate(pitched(band), start=1):
        assert read_midi(path, (number,)).notes == part.notes  # to the bit
        assert read_midi(path, (number,)).pedal == part.pedal


@few
def test_the_file_has_tempo_metre_and_bars(seed: int, tmp_path: Path) -> None:
    band = bands()[seed]
    write_band(band, path := tmp_path / "song.mid")
    first, *others = mido.MidiFile(path).tracks
    meta = {message.type: message for message in first}
    assert round(mido.tempo2bpm(meta["set_tempo"].tempo)) == band.tempo
    assert (meta["time_signature"].numerator, meta["time_signature"].denominator) == (band.beats, 4)
    assert len(others) == len(band.parts)
    bar = band.beats * 60 / band.tempo
    bars = read_midi(path).bars
    assert len(bars) == round(band.sections[-1].end / bar)
    begins = {round(bar.time, 3) for bar in bars}
    assert {round(section.start, 3) for section in band.sections} <= begins


def test_a_song_can_be_named_where_a_song_is_asked_for() -> None:
    score = load_score("etudes/band-7")
    assert len(score.tracks) == len(pitched(make_band(7)))
    assert load_score("etudes/band-7", (2,)).notes == pitched(make_band(7))[1].notes
    songs = open_library("etudes:band:3").songs
    assert [song.name for song in songs] == ["etudes/band-0", "etudes/band-1", "etudes/band-2"]
    with pytest.raises(CadenzaError, match="there is no track 99"):
        load_score("etudes/band-7", (99,))


@pytest.mark.parametrize("seed", [-1, 2**200])
def test_other_seeds_are_refused(seed: int) -> None:
    with pytest.raises(CadenzaError, match="seed"):
        make_band(seed)


# Roles


def test_every_note_has_a_role() -> None:
    for band in bands():
        assert all(len(part.notes) == len(part.roles) for part in band.parts)
        assert sum(len(part.notes) for part in band.parts) == sum(
            len(band.notes(role)) for role in ROLES
        )
        for part in band.parts:
            assert (part.channel == 10) == (set(part.roles) == {"drums"})
        assert band.notes("melody")
        assert band.notes("bass")
    channels = [[part.channel for part in band.parts] for band in bands()]
    assert all(len(set(numbers)) == len(numbers) for numbers in channels)


def test_sections_say_who_has_the_melody() -> None:
    for band in bands():
        beat = 60 / band.tempo
        for section, after in pairwise(band.sections):
            assert section.end == after.start
        for section in band.sections:
            having = {
                i
                for i, part in enumerate(band.parts)
                for note, role in zip(part.notes, part.roles, strict=True)
                # Pickups of the next section may come before it begins.
                if role == "melody"
                and section.start - JITTER <= note.start < section.end - 1.7 * beat
            }
            assert having == ({section.melody} - {None})


def test_who_doubles_plays_the_melody_in_unison_or_octaves() -> None:
    found = 0
    for band in bands():
        melody = band.notes("melody")
        starts = np.array([note.start for note in melody])
        for note in band.notes("doubling"):
            near = melody[int(np.abs(starts - note.start).argmin())]
            assert abs(near.start - note.start) < 2 * JITTER
            assert (near.pitch - note.pitch) % 12 == 0
            found += 1
    assert found > 100


# Music


def test_songs_have_usual_lengths_tempi_and_ranges() -> None:
    for band in bands():
        assert 60 <= band.sections[-1].end <= 180
        assert 70 <= band.tempo <= 160
        assert all(note.pitch in PITCHES for part in band.parts for note in part.notes)
        for part in band.parts:
            ends: dict[int, float] = {}
            for note in part.notes:
                assert note.start >= ends.get(note.pitch, 0.0)
                ends[note.pitch] = note.end
        assert all(28 <= note.pitch <= 55 for note in band.notes("bass"))
    assert {band.beats for band in bands()} == {3, 4}
    assert len({band.style for band in bands()}) >= 6


def melodies(band: Band) -> list[list[Note]]:
    """The melody of each part that ever has it."""
    found = (
        [note for note, role in zip(part.notes, part.roles, strict=True) if role == "melody"]
        for part in band.parts
    )
    return [notes for notes in found if notes]


def test_melodies_can_be_sung() -> None:
    intervals = []
    for band in bands():
        for notes in melodies(band):
            pitches = [note.pitch for note in notes]
            assert max(pitches) - min(pitches) <= 31
            assert all(a.end <= b.start for a, b in pairwise(notes))
            intervals += [abs(a - b) for a, b in pairwise(pitches)]
            beat = 60 / band.tempo
            breath = notes[0].start
            for a, b in pairwise(notes):
                if b.start - a.end > 0.4 * beat:
                    breath = b.start
                assert b.end - breath < 8.2 * band.beats * beat
    counts = np.bincount(intervals)
    assert counts[1:3].sum() > 0.35 * counts.sum()  # steps
    assert 0.15 < counts[0] / counts.sum() < 0.4  # repeated
    assert counts[8:].sum() < 0.03 * counts.sum()


@few
def test_melody_and_bass_fit_the_chords(seed: int) -> None:
    band = bands()[seed]
    bar = 60 / band.tempo * band.beats

    def on_downbeat(note: Note) -> bool:
        return abs((note.start + bar / 2) % bar - bar / 2) <= JITTER

    def fits(note: Note) -> bool:
        start = note.start + 4 * JITTER
        return note.pitch % 12 in sounding(band, start, start + 90 / band.tempo)

    assert share([fits(note) for note in band.notes("melody") if on_downbeat(note)]) > 0.75
    lowest = [
        min((n for part in pitched(band) for n in part.notes if n.start <= time < n.end),
            key=lambda n: n.pitch).pitch % 12 == note.pitch % 12
        for note in band.notes("bass")
        if on_downbeat(note)
        for time in [note.start + 4 * JITTER]
    ]  # fmt: skip
    assert share(lowest) > 0.8


def test_songs_are_as_different_as_those_of_real_files() -> None:
    highest = []
    for band in bands():
        above = [
            max((n.pitch for n in band.notes("harmony") if n.start <= m.start + 0.05 < n.end),
                default=0) > m.pitch
            for m in band.notes("melody")[::5]
        ]  # fmt: skip
        highest.append(1 - share(above))
    assert min(highest) < 0.1
    assert max(highest) > 0.7
    moves = [len({s.melody for s in band.sections} - {None}) > 1 for band in bands()]
    assert 0.3 < share(moves) < 1
    assert 0.1 < share([bool(band.notes("doubling")) for band in bands()]) < 0.7
    assert 0.1 < share([any(part.pedal for part in band.parts) for band in bands()]) < 0.7
    nameless = [all(not part.name for part in band.parts) for band in bands()]
    assert 0.03 < share(nameless) < 0.4
