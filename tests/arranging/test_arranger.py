"""Arrangements of songs for a band, whose melody and bass are known."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.arranging import bands
from cadenza.arranging.arranger import Arranger
from cadenza.arranging.fidelity import Fidelity
from cadenza.arranging.moments import beats_of
from cadenza.fingering.search import find_fingering
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Bar, Note, Score, Track
from cadenza.tasks.goal_track import players_of

SONGS = ("benchmark/band-1026", "benchmark/band-1029", "benchmark/band-1031")
EASY = "benchmark/band-1026"


@pytest.fixture(scope="module")
def arranger(scene):
    return Arranger(players_of(scene), scene.hand.jump_times)


@pytest.fixture(scope="module", params=SONGS)
def song(request):
    return str(request.param)


@pytest.fixture(scope="module")
def arranged(song, arranger):
    return arranger.arrange(load_score(song))


def share_kept(notes: tuple[Note, ...], score: Score, octaves: bool = False) -> float:
    """The share of notes of which one begins within 0.06 s in the score."""
    pitches = 12 if octaves else 128
    start = np.array([note.start for note in score.notes])
    pitch = np.array([note.pitch for note in score.notes]) % pitches
    matches = [
        (np.abs(start[pitch == note.pitch % pitches] - note.start) < 0.06).any() for note in notes
    ]
    return float(np.mean(matches))


def test_melody_and_bass_stay(song, arranged):
    melody, bass = dict(bands())[song]
    assert share_kept(melody, arranged.score) > 0.97
    assert share_kept(bass, arranged.score, octaves=True) > 0.97
    assert arranged.fidelity.melody_kept > 0.97
    assert arranged.fidelity.pitch_classes_kept > 0.8


def test_the_hands_can_play_all_of_it(song, arranged, scene):
    assert len(arranged.score.notes) < len(load_score(song).notes)
    _, dropped = find_fingering(arranged.score, players_of(scene))
    assert not dropped


def test_an_easier_arrangement_has_fewer_notes(arranger):
    score = load_score(EASY).beginning(12.0)
    hard, easy = arranger.arrange(score), arranger.arrange(score, grade=4.0)
    assert easy.grade < hard.grade
    assert len(easy.score.notes) < len(hard.score.notes)
    assert easy.fidelity.melody_kept > 0.97


def test_what_is_playable_is_kept_note_for_note_but_softer_inside(arranger):
    notes = tuple(
        Note(0.5 * i, 0.5 * i + 0.45, pitch)
        for i, root in enumerate((60, 62, 64, 65))
        for pitch in (root - 12, root, root + 4, root + 7)
    )
    arranged = arranger.arrange(Score(notes))
    assert [n.pitch for n in arranged.score.notes] == [n.pitch for n in Score(notes).notes]
    assert arranged.fidelity.others_kept == 1.0
    assert str(arranged.fidelity) == "all notes kept"


def test_a_fidelity_says_all_or_none_only_where_it_is_so():
    one_hand = Fidelity(1.0, 0.0, 0.997, 1.0, 0, 0)
    assert str(one_hand) == "all of the melody, none of the bass, 99% of the other notes"


def test_an_empty_score_stays_empty(arranger):
    assert not arranger.arrange(Score(())).score.notes


def test_each_note_has_its_fate(song, arranged):
    played = sorted(note.pitch for note in arranged.score.notes)
    assert sorted(fate.played for fate in arranged.fates if fate.played is not None) == played
    written = {(note.start, note.pitch) for note in load_score(song).notes}
    for note, _ in arranged.fates:
        assert note.added or (note.start, note.pitch) in written


@pytest.mark.parametrize("level", [5, 6, 8])
def test_an_arrangement_is_at_most_as_hard_as_its_level(level, arranger):
    score = load_score(EASY).beginning(20.0)
    assert arranger.arrange(score, grade=level).grade <= level


def test_below_all_levels_melody_and_bass_are_left(arranger):
    arranged = arranger.arrange(load_score(EASY).beginning(20.0), grade=1.0)
    assert arranged.grade > 1
    assert arranged.fidelity.melody_kept == arranged.fidelity.bass_kept == 1
    assert arranged.fidelity.others_kept < 0.05


def song_for_three(chord: tuple[Note, ...], bars: tuple[Bar, ...]) -> Score:
    """A melody high up and a bass far below, which hands cannot leave, and a chord between."""
    melody = [Note(0.5 * i, 0.5 * i + 0.5, 84 + i % 3, tracks=(1,)) for i in range(16)]
    bass = [Note(1.0 * i, 1.0 * i + 1, 36, tracks=(3,)) for i in range(8)]
    inner = [replace(note, tracks=(2,)) for note in chord]
    names = ("Melody", "Flute"), ("Pad", "Pad 2 (warm)"), ("Bass", "Acoustic bass")
    tracks = tuple(Track(i, *name, i, 1, 1, 1) for i, name in enumerate(names, start=1))
    return Score((*melody, *bass, *inner), tracks=tracks, bars=bars)


FOURS = tuple(Bar(2.0 * i, i + 1, tuple(2.0 * i + b for b in (0, 0.5, 1, 1.5))) for i in range(4))
TWOS = tuple(Bar(2.0 * i, i + 1, (2.0 * i, 2.0 * i + 1)) for i in range(4))


def test_a_chord_that_cannot_be_struck_at_once_is_broken(arranger):
    wide = tuple(Note(2.0 * i, 2.0 * i + 1.9, p) for i in range(4) for p in (48, 55, 64, 71, 77))
    arranged = arranger.arrange(song_for_three(wide, TWOS))
    late = [n for n in arranged.score.notes if 40 < n.pitch < 80 and n.start % 2 > 0.1]
    assert len(late) >= 4
    assert arranged.fidelity.pitch_classes_kept > 0.85


def test_a_chord_is_struck_again_when_a_piano_would_have_died_away(arranger):
    held = tuple(Note(0.0, 8.0, pitch) for pitch in (64, 67))
    fidelity = arranger.arrange(song_for_three(held, FOURS)).fidelity
    assert 1 < fidelity.notes_added <= 8


def test_keys_come_up_between_repeated_notes_of_the_melody(arranger):
    sung = tuple(Note(0.25 * i, 0.25 * (i + 1), 72) for i in range(8))
    notes = arranger.arrange(Score(sung)).score.notes
    assert [note.start for note in notes] == [note.start for note in sung]
    assert all(after.start - note.end > 0.05 for note, after in pairwise(notes))


def test_without_bars_beats_are_estimated(arranger):
    score = load_score(EASY).beginning(20.0)
    kept, estimated = (arranger.arrange(each).fidelity for each in (score, replace(score, bars=())))
    assert estimated.melody_kept == pytest.approx(kept.melody_kept, abs=0.03)
    assert beats_of(replace(score, bars=()))[-1] > score.total_time - 1.2
