"""Arrangements of songs for a band, whose melody and bass are known."""

from __future__ import annotations

import numpy as np
import pytest

from cadenza.arranging.arranger import Arranger
from cadenza.fingering.search import find_fingering
from cadenza.music.etudes.band import Band, band_score, make_band
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.tasks.goal_track import players_of

SEEDS = (2, 5, 11)  # others than those by which the weights were chosen


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(SceneConfig())


@pytest.fixture(scope="module")
def arranger(scene: Scene) -> Arranger:
    return Arranger(players_of(scene), scene.hand.jump_times)


@pytest.fixture(scope="module", params=SEEDS)
def band(request: pytest.FixtureRequest) -> Band:
    return make_band(request.param)


def share_found(wanted: tuple[Note, ...], score: Score, octaves: bool = False) -> float:
    """The share of notes of which one begins within 0.06 s in the score."""
    pitches = 12 if octaves else 128
    start = np.array([note.start for note in score.notes])
    pitch = np.array([note.pitch for note in score.notes]) % pitches
    found = [
        (np.abs(start[pitch == note.pitch % pitches] - note.start) < 0.06).any() for note in wanted
    ]
    return float(np.mean(found))


def test_melody_and_bass_stay(band: Band, arranger: Arranger) -> None:
    arranged = arranger.arrange(band_score(band))
    assert share_found(band.notes("melody"), arranged.score) > 0.97
    assert share_found(band.notes("bass"), arranged.score, octaves=True) > 0.97
    assert arranged.fidelity.melody_kept > 0.97
    assert arranged.fidelity.pitch_classes_kept > 0.8


def test_the_hands_can_play_all_of_it(band: Band, arranger: Arranger, scene: Scene) -> None:
    arranged = arranger.arrange(band_score(band)).score
    assert len(arranged.notes) < len(band_score(band).notes)
    _, dropped = find_fingering(arranged, players_of(scene))
    assert not dropped


def test_an_easier_arrangement_has_fewer_notes(arranger: Arranger) -> None:
    score = band_score(make_band(3))
    hard, easy = arranger.arrange(score), arranger.arrange(score, grade=4.0)
    assert easy.grade < hard.grade
    assert len(easy.score.notes) < len(hard.score.notes)
    assert easy.fidelity.melody_kept > 0.97


def test_what_is_playable_is_kept_note_for_note_but_softer_inside(arranger: Arranger) -> None:
    notes = tuple(
        Note(0.5 * i, 0.5 * i + 0.45, pitch)
        for i, root in enumerate((60, 62, 64, 65))
        for pitch in (root - 12, root, root + 4, root + 7)
    )
    arranged = arranger.arrange(Score(notes))
    assert [n.pitch for n in arranged.score.notes] == [n.pitch for n in Score(notes).notes]
    assert arranged.fidelity.others_kept == 1.0
    assert str(arranged.fidelity) == "melody and bass whole, 100% of the other notes"


def test_an_empty_score_stays_empty(arranger: Arranger) -> None:
    assert not arranger.arrange(Score(())).score.notes


def test_each_note_has_its_fate(band: Band, arranger: Arranger) -> None:
    arranged = arranger.arrange(band_score(band))
    played = sorted((round(n.start, 6), n.pitch) for n in arranged.score.notes)
    fates = [(round(f.note.start, 6), f.played) for f in arranged.fates if f.played is not None]
    assert sorted(fates) == played
    written = {(note.start, note.pitch) for note in band_score(band).notes}
    for note, _ in arranged.fates:
        assert note.added or (note.start, note.pitch) in written
