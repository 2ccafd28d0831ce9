"""Tempo maps: places in the music to seconds."""

from fractions import Fraction as Q

import numpy as np
import pytest
from scipy.integrate import quad

from cadenza.music.signs.conventions import LONG_FERMATA
from cadenza.music.signs.tempo_map import (
    Caesura,
    Fermata,
    Tempo,
    TempoChange,
    TempoMap,
    TempoWord,
    says_tempo,
)

QUARTERS = [Q(k) for k in range(17)]


def onsets(marks, places=QUARTERS, end=Q(16)):
    return TempoMap.of(marks, end).onsets(places)


def test_without_marks_a_quarter_is_half_a_second():
    assert onsets([]).tolist() == [k / 2 for k in range(17)]


def test_tempos_change_where_they_stand():
    got = onsets([Tempo(Q(4), 0.25), Tempo(Q(0), 1.0)])
    assert got[:5].tolist() == [0, 1, 2, 3, 4]
    assert got[8] == 5


def test_a_ritardando_slows_down_evenly_until_a_tempo():
    marks = [
        Tempo(Q(0), 0.6),
        TempoWord(Q(4), TempoChange.RITARDANDO),
        TempoWord(Q(8), TempoChange.A_TEMPO),
    ]
    got = onsets(marks)
    last = 0.6 / 0.75
    expected, _ = quad(lambda q: 0.6 + (last - 0.6) * (q - 4) / 4, 4, 8)
    assert got[8] - got[4] == pytest.approx(expected)
    assert np.all(np.diff(got[4:9], 2) > 0)
    assert np.diff(got[8:]) == pytest.approx(0.6)


def test_a_ritardando_leads_to_a_slower_tempo_and_an_accelerando_to_a_faster_one():
    for change, tempo in ((TempoChange.RITARDANDO, 1.5), (TempoChange.ACCELERANDO, 0.5)):
        got = onsets([Tempo(Q(0), 1.0), TempoWord(Q(0), change), Tempo(Q(8), tempo)])
        assert got[8] == pytest.approx(8 * (1 + tempo) / 2)
    against = onsets([Tempo(Q(0), 1.0), TempoWord(Q(4), TempoChange.RITARDANDO), Tempo(Q(8), 0.5)])
    assert against[8] - against[4] == pytest.approx(4 * (1 + 1 / 0.75) / 2)


def test_a_ritardando_that_the_score_forgets_does_not_slow_down_all_that_follows():
    marks = [Tempo(Q(0), 1.0), TempoWord(Q(0), TempoChange.RITARDANDO)]
    lengths = np.diff(onsets(marks, places=[Q(k) for k in range(30)], end=Q(40)))
    assert lengths[15] > 1.3
    assert lengths[16:] == pytest.approx(1.0)


def test_a_last_ritardando_goes_on_to_the_end():
    got = onsets([Tempo(Q(0), 1.0), TempoWord(Q(12), TempoChange.RITARDANDO)])
    assert got[16] - got[12] == pytest.approx(4 * (1 + 1 / 0.75) / 2)


def test_a_tempo_leads_back_to_what_was_before_and_tempo_primo_to_the_beginning():
    marks = [
        Tempo(Q(0), 0.5),
        Tempo(Q(2), 1.0),
        TempoWord(Q(4), TempoChange.MENO_MOSSO),
        TempoWord(Q(6), TempoChange.A_TEMPO),
        TempoWord(Q(8), TempoChange.TEMPO_PRIMO),
    ]
    lengths = np.diff(onsets(marks)).tolist()
    assert lengths == pytest.approx([0.5] * 2 + [1] * 2 + [1 / 0.85] * 2 + [1] * 2 + [0.5] * 8)


def test_a_tempo_for_playback_overrules_the_word_beside_it():
    for word in (TempoChange.MENO_MOSSO, TempoChange.RITARDANDO):
        marks = [Tempo(Q(0), 1.0), Tempo(Q(4), 2.0), TempoWord(Q(4), word)]
        assert np.diff(onsets(marks))[4:] == pytest.approx(2.0)


def test_at_a_fermata_all_parts_wait_and_notes_are_held():
    tempo = TempoMap.of([Fermata(Q(3), Q(4)), Fermata(Q(2), Q(4))])
    assert tempo.onsets([Q(3), Q(4), Q(5)]).tolist() == [1.5, 2.5, 3.0]
    assert tempo.ends([Q(4)]).tolist() == [2.5]
    long = TempoMap.of([Fermata(Q(2), Q(4), LONG_FERMATA)])
    assert long.onsets([Q(4)]).tolist() == [4.0]
    barline = TempoMap.of([Fermata(Q(4), Q(4))])
    assert barline.onsets([Q(4)]).tolist() == [2.5]


def test_at_a_caesura_there_is_silence():
    tempo = TempoMap.of([Caesura(Q(4))])
    assert tempo.ends([Q(4)]).tolist() == [2.0]
    assert tempo.onsets([Q(4), Q(5)]).tolist() == [2.5, 3.0]


def test_sections_are_played_one_after_the_other_with_their_waits():
    marks = [Tempo(Q(0), 1.0), Fermata(Q(3), Q(4)), Caesura(Q(8)), Tempo(Q(6), 0.5)]
    sheet = TempoMap.of(marks)
    played = sheet.played([(Q(0), Q(4)), (Q(2), Q(8)), (Q(1), Q(2))])
    assert played.onsets([Q(0), Q(4), Q(6), Q(8), Q(10)]).tolist() == [0, 5, 8, 10, 11.5]
    assert played.ends([Q(4), Q(10), Q(11)]).tolist() == [5, 11, 12.5]


def test_the_last_note_is_held_by_a_fermata_where_the_music_is_played_by_sections():
    sheet = TempoMap.of([Fermata(Q(3), Q(4))])
    assert sheet.played([(Q(0), Q(4)), (Q(0), Q(4))]).ends([Q(4), Q(8)]).tolist() == [2.5, 5.0]


def test_plain_has_tempos_only():
    marks = [
        Tempo(Q(0), 1.0),
        TempoWord(Q(1), TempoChange.RITARDANDO),
        Fermata(Q(3), Q(4)),
        Caesura(Q(8)),
        TempoWord(Q(9), TempoChange.PIU_MOSSO),
        Tempo(Q(12), 0.5),
    ]
    assert np.diff(onsets(filter(says_tempo, marks))).tolist() == [1.0] * 12 + [0.5] * 4
