"""Drills for one hand: that they are what they are called, and that a hand can play them."""

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.fingering.players import players_at
from cadenza.fingering.search import find_fingering
from cadenza.hands.allegro import ALLEGRO
from cadenza.keyboards.mini import MINI
from cadenza.music.etudes import DRILLS, make_etude
from cadenza.music.libraries.library import load_score

PLAYERS = players_at(ALLEGRO.reach, MINI, ("right",), hand_spacing=0.0, slides=True)


@given(st.sampled_from([*DRILLS]), st.integers(1, 10), st.integers(0, 2**32))
@settings(deadline=None, max_examples=40)
def test_a_drill_is_so_many_notes_or_chords_for_four_fingers(kind, count, seed):
    score = make_etude(kind, count, seed)
    at_once = [
        [note.pitch for note in notes]
        for _, notes in itertools.groupby(score.notes, key=lambda note: note.start)
    ]
    assert [len(chord) for chord in at_once] == [DRILLS[kind]] * count
    assert all(before != after for before, after in itertools.pairwise(at_once))
    assert all(pitch in MINI.pitches for chord in at_once for pitch in chord)
    gaps = [b - a for chord in at_once for a, b in itertools.pairwise(chord)]
    assert all(3 <= gap <= 9 for gap in gaps)  # fingers are wider than keys
    assert find_fingering(score, PLAYERS)[1] == ()


def test_seeds_make_others_and_names_name_them():
    melodies = {make_etude("notes", 6, seed).notes for seed in range(20)}
    assert len(melodies) == 20
    assert load_score("etudes/dyads-3-7") == make_etude("dyads", 3, 7)


def test_drills_are_the_same_on_every_machine():
    """Results name them by their seeds only."""
    expected = [
        [64, 69, 72],
        [60, 67, 63, 67, 58, 67],
        [60, 65, 69, 55, 59, 64, 62, 67, 71],
        [55, 58, 62, 67, 53, 58, 62, 65, 55, 58, 62, 65],
    ]
    pitches = [[note.pitch for note in make_etude(kind, 3, 0).notes] for kind in DRILLS]
    assert pitches == expected


def test_other_kinds_are_refused():
    with pytest.raises(CadenzaError, match=r"'pentads': choose from .*trills.*, dyads, triads"):
        make_etude("pentads", 3, 0)
