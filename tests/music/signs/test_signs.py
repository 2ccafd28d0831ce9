"""Tempo maps, dynamics, hairpins, and the words for them."""

from fractions import Fraction as Q

import numpy as np
import pytest
from scipy.integrate import quad

from cadenza.music.signs import LONG_FERMATA
from cadenza.music.signs.loudness import Dynamic, Hairpin, Loudness, Sforzato
from cadenza.music.signs.tempo_map import (
    Caesura,
    Fermata,
    Tempo,
    TempoChange,
    TempoMap,
    TempoWord,
    loudness_step,
    says_tempo,
    swing,
    tempo_change,
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


def test_an_accelerando_leads_to_the_tempo_of_the_beginning_if_that_is_faster():
    for change, reached in ((TempoChange.ACCELERANDO, 0.5), (TempoChange.RITARDANDO, 1 / 0.75)):
        marks = [Tempo(Q(0), 0.5), Tempo(Q(4), 1.0)]
        marks += [TempoWord(Q(8), change), TempoWord(Q(12), TempoChange.TEMPO_PRIMO)]
        got = onsets(marks)
        assert got[12] - got[8] == pytest.approx(4 * (1 + reached) / 2)
        assert got[13] - got[12] == pytest.approx(0.5)


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


@pytest.mark.parametrize(
    ("text", "change"),
    [
        ("rit.", TempoChange.RITARDANDO),
        ("poco rit.", TempoChange.RITARDANDO),
        ("Rallentando", TempoChange.RITARDANDO),
        ("molto allargando", TempoChange.RITARDANDO),
        ("accel.", TempoChange.ACCELERANDO),
        ("stringendo", TempoChange.ACCELERANDO),
        ("a tempo", TempoChange.A_TEMPO),
        ("A  Tempo", TempoChange.A_TEMPO),
        ("Tempo I", TempoChange.TEMPO_PRIMO),
        ("Tempo I°", TempoChange.TEMPO_PRIMO),
        ("Tempo primo", TempoChange.TEMPO_PRIMO),
        ("ritenuto", TempoChange.MENO_MOSSO),
        ("Più mosso", TempoChange.PIU_MOSSO),
        ("meno mosso", TempoChange.MENO_MOSSO),
        ("con spirito", None),
        ("tempo giusto", None),
        ("Tempo di valse", None),
        ("Allegro ma non troppo", None),
    ],
)
def test_words_change_the_tempo(text, change):
    assert tempo_change(text) is change


@pytest.mark.parametrize(
    ("text", "step"),
    [("cresc.", 1), ("poco a poco crescendo", 1), ("decresc.", -1), ("dim.", -1), ("dolce", None)],
)
def test_words_change_the_loudness(text, step):
    assert loudness_step(text) == step


def test_words_say_whether_eighths_swing():
    assert swing("Medium Swing") == (2, 1)
    assert swing("straight 8ths") == (1, 1)
    assert swing("Andante") is None


P, MF, F_ = 49, 80, 96


def velocities(*marks):
    loudness = Loudness(marks, unmarked=MF)
    return [loudness.at(Q(k)) for k in range(9)]


def test_dynamics_hold_until_the_next():
    assert velocities(Dynamic(Q(2), P), Dynamic(Q(4), F_)) == [MF] * 2 + [P] * 2 + [F_] * 5


def test_a_hairpin_leads_from_one_dynamic_to_the_next():
    got = velocities(Dynamic(Q(0), 40), Hairpin(Q(0), Q(4), 1), Dynamic(Q(4), 80))
    assert got == [40, 50, 60, 70, 80, 80, 80, 80, 80]


def test_a_hairpin_without_goal_changes_by_one_dynamic():
    assert velocities(Hairpin(Q(0), Q(4), -1)) == [80, 76, 72, 68, 64, 64, 64, 64, 64]
    sudden = velocities(Hairpin(Q(0), Q(4), 1), Dynamic(Q(4), P))
    assert sudden == [80, 84, 88, 92, P, P, P, P, P]


def test_a_swell_goes_up_and_down():
    got = velocities(Hairpin(Q(0), Q(2), 1), Hairpin(Q(2), Q(4), -1))
    assert got == [80, 88, 96, 88, 80, 80, 80, 80, 80]


def test_a_crescendo_in_words_goes_on_to_the_next_dynamic():
    got = velocities(Hairpin(Q(0), None, 1), Dynamic(Q(8), 120))
    assert got == [80, 85, 90, 95, 100, 105, 110, 115, 120]


def test_sforzato_and_forte_piano_are_for_their_notes_alone():
    assert velocities(Sforzato(Q(1)))[:3] == [80, 120, 80]
    assert velocities(Dynamic(Q(1), F_, then=P))[:4] == [80, F_, P, P]


def test_velocities_stay_within_midi():
    softest = velocities(Dynamic(Q(0), 2), Hairpin(Q(0), Q(4), -1))
    loudest = velocities(Dynamic(Q(0), 120), Hairpin(Q(0), Q(4), 1), Sforzato(Q(1)))
    assert min(softest) == 1
    assert max(loudest) == 127
