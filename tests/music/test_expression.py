import time
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from cadenza.errors import CadenzaError
from cadenza.music.arrangement import Arrangement
from cadenza.music.etudes import make_etude
from cadenza.music.expression import VELOCITY_PER_DECIBEL, ExpressionConfig, performed
from cadenza.music.score import Bar, Note, PedalEvent, Score
from music_strategies import monophonic_per_key, scores

OFF = ExpressionConfig(**{f.name: 0.0 for f in fields(ExpressionConfig)})
NONE = replace(OFF, dose=1.0)
RULES = [f.name for f in fields(ExpressionConfig) if f.name != "dose"]


def line(pitches, lengths, velocity=64, **others):
    """A legato melody from 1 s on."""
    starts = 1 + np.concatenate([[0], np.cumsum(lengths)])
    return Score(
        tuple(
            Note(float(start), float(end), pitch, velocity)
            for pitch, start, end in zip(pitches, starts[:-1], starts[1:], strict=True)
        ),
        **others,
    )


def only(rule, k=1.0):
    return replace(NONE, **{rule: k})


def intervals(score):
    return np.diff([note.start for note in score.notes])


def velocities(score):
    return np.array([note.velocity for note in score.notes])


def lengthened(score, rule, k=1.0):
    return intervals(performed(score, only(rule, k))) - intervals(score)


CHORALE = make_etude("chorale", 5, 0)
SCALE = line(range(60, 73), [0.25] * 13)


@given(scores())
def test_dose_0_is_the_score_bit_for_bit(score):
    score = replace(score, bars=(Bar(-0.5, 1), Bar(2 / 3, 2)))
    for result in (performed(score, ExpressionConfig(dose=0.0)), performed(score, NONE)):
        assert result == score
        assert result.bars == score.bars


def test_a_tiny_dose_changes_hardly_anything():
    result = performed(CHORALE, ExpressionConfig(dose=1e-15))
    assert velocities(result).tolist() == velocities(CHORALE).tolist()
    assert result.notes[-1].start == pytest.approx(CHORALE.notes[-1].start)


def test_no_notes():
    assert performed(Score(())) == Score(())


@given(scores().map(monophonic_per_key))
def test_keys_and_fingers_stay_and_notes_of_a_key_do_not_overlap(score):
    result = performed(score, ExpressionConfig(dose=4.0, inegales=1.0))
    for pitch in range(128):
        before = [note for note in score.notes if note.pitch == pitch]
        after = [note for note in result.notes if note.pitch == pitch]
        assert [note.finger for note in before] == [note.finger for note in after]
        assert all(a.end <= b.start for a, b in pairwise(after))
    assert [event.value for event in result.pedal] == [event.value for event in score.pedal]
    assert performed(score, ExpressionConfig(dose=4.0, inegales=1.0)) == result


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("score", [CHORALE, make_etude("counterpoint", 5, 1)])
def test_a_rule_scales_with_the_dose(score, rule):
    halved = performed(score, replace(only(rule, 1.0), dose=0.5))
    assert halved == performed(score, only(rule, 0.5))


def test_high_loud_is_3_decibels_an_octave_and_moves_nothing():
    score = line([48, 60, 72], [1, 1, 1])
    result = performed(score, only("high_loud"))
    assert velocities(result).tolist() == [
        64 - round(3 * VELOCITY_PER_DECIBEL),
        64,
        64 + round(3 * VELOCITY_PER_DECIBEL),
    ]
    assert [(n.start, n.end) for n in result.notes] == [(n.start, n.end) for n in score.notes]


def test_velocities_stay_in_midi():
    loud = performed(line([21, 108], [1, 1], 126), only("high_loud", 10.0))
    soft = performed(line([21, 108], [1, 1], 2), only("high_loud", 10.0))
    assert velocities(loud)[1] == 127
    assert velocities(soft)[0] == 1


def test_duration_contrast_shortens_notes_of_a_fifth_of_a_second_most():
    score = line([60] * 5, [0.7, 0.2, 0.4, 0.7, 0.7])
    expected = [0, -11 * 1.5e-3, -7 * 1.5e-3, 0]
    assert lengthened(score, "duration_contrast") == pytest.approx(expected)
    result = performed(score, only("duration_contrast", 4.0))
    softer = round(4 * 0.075 * 11 * VELOCITY_PER_DECIBEL)
    assert velocities(result)[[0, 1, 3]].tolist() == [64, 64 - softer, 64]


def test_double_duration_evens_out_two_to_one():
    score = line([60] * 4, [0.8, 0.8, 0.4, 0.8])
    assert lengthened(score, "double_duration") == pytest.approx([0, -0.048, 0.048])
    assert lengthened(score, "duration_contrast") == pytest.approx([0, 0, 0])


def test_faster_uphill_shortens_ascending_notes_by_2_milliseconds():
    score = line([60, 62, 64, 62, 60, 62, 60], [0.5] * 7)
    expected = [-0.002, -0.002, 0, 0, 0, 0]
    assert lengthened(score, "faster_uphill") == pytest.approx(expected)


def test_phrase_arch_slows_down_and_softens_both_ends():
    score = line([60] * 22, ([0.5] * 10 + [1.5]) * 2)
    result = performed(score, only("phrase_arch"))
    slower = intervals(result) / intervals(score)
    assert slower[[0, 3, 10, 11, 14]] == pytest.approx([1.1, 1, 1.2, 1.1, 1])
    softer = (64 - velocities(result)) / VELOCITY_PER_DECIBEL
    assert softer[[0, 3, 10, 11, 21]] == pytest.approx([1, 0, 2, 1, 2], abs=0.2)


def test_a_phrase_ends_before_a_rest():
    written = line([60] * 20, [0.5] * 20)
    notes = list(written.notes)
    notes[9] = replace(notes[9], end=notes[9].start + 0.2)
    slower = lengthened(replace(written, notes=tuple(notes)), "phrase_arch") / 0.5
    assert slower[[9, 10]] == pytest.approx([0.2, 0.1])


def test_punctuation_pauses_after_the_longest_of_five():
    score = line([60, 62, 64, 65, 67, 69], [0.32, 0.32, 0.64, 0.32, 0.32, 0.32])
    result = performed(score, only("punctuation"))
    assert lengthened(score, "punctuation") == pytest.approx([0, 0, 0.45 * 0.06, 0, 0])
    gaps = [b.start - a.end for a, b in pairwise(result.notes)]
    assert gaps == pytest.approx([0, 0, 0.06, 0, 0])
    assert (velocities(result) == 64).all()


def test_punctuation_sets_leaps_apart():
    score = line([60, 62, 64, 55, 57, 59, 60], [0.4] * 7)
    result = performed(score, only("punctuation"))
    gaps = [b.start - a.end for a, b in pairwise(result.notes)]
    assert gaps == pytest.approx([0, 0, 0.04, 0, 0, 0])


def test_final_ritard_ends_at_a_quarter_of_the_tempo():
    score = line([60, 62] * 100, [0.04] * 200)
    result = performed(score, only("final_ritard"))
    tempo = intervals(score) / intervals(result)
    left = score.notes[-1].start - np.array([note.start for note in score.notes[:-1]])
    assert tempo[left > 1.33] == pytest.approx(1)
    assert (np.diff(tempo[left < 1.33]) < 0).all()
    # The cube of the tempo falls linearly, to 1/64.
    cubed = tempo[left < 1.33] ** 3
    assert np.diff(cubed[:-2]) == pytest.approx(np.diff(cubed)[0], rel=0.02)
    assert 1 / 4 < tempo[-1] < tempo[-2] < 1 / 2
    assert result.total_time - result.notes[-1].start == pytest.approx(1.25 * intervals(result)[-1])


@pytest.mark.parametrize("quantity", [0.2, 1.0, 2.0])
def test_the_last_tempo_of_a_final_ritard_depends_on_its_quantity(quantity):
    score = line([60, 62] * 200, [0.033] * 400)
    result = performed(score, only("final_ritard", quantity))
    before_last, last = (intervals(score) / intervals(result))[-2:]
    # Where the cube of the tempo is linear in written time, its end lies half an interval later.
    end = 1 / (1 + 3 * quantity)
    assert end < last < before_last
    assert last**3 - (before_last**3 - last**3) / 2 == pytest.approx(end**3, abs=0.01)


def test_a_final_ritard_slows_down_what_is_below_a_held_note():
    held = Note(1, 5, 84)
    below = line([60, 62] * 20, [0.1] * 40)
    result = performed(replace(below, notes=(held, *below.notes)), only("final_ritard"))
    onsets = np.array([note.start for note in result.notes if note.pitch != 84])
    assert (np.diff(np.diff(onsets))[-10:] > 0).all()
    assert max(result.notes, key=lambda note: note.pitch).end == pytest.approx(result.total_time)


def test_other_notes_of_a_chord_follow_a_louder_melody():
    chord = Score((Note(1, 2, 60, 64), Note(1, 2, 64, 64), Note(1, 2, 72, 64), Note(2, 3, 71, 64)))
    result = performed(chord, only("melody_lead"))
    assert [note.start for note in result.notes] == pytest.approx([1, 1.025, 1.025, 2])
    assert (result.notes[0].pitch, result.notes[0].velocity) == (72, 64 + 8)
    assert [note.end for note in result.notes] == [2, 2, 2, 3]


def test_inegales_lengthens_the_first_of_two_eighths():
    bars = (Bar(1, 1), Bar(2, 2))
    score = line(range(60, 69), [0.25] * 9, bars=bars)
    given = 0.22 * 0.25
    assert lengthened(score, "inegales") == pytest.approx([given, -given] * 4)
    assert lengthened(replace(score, bars=()), "inegales") == pytest.approx([0] * 8)


def test_what_is_below_the_melody_pedal_and_bars_follow_its_time():
    melody = line([72] * 3, [1.0, 0.1, 1.0])
    bass = Note(1.5, 2.05, 40)
    score = replace(
        melody,
        notes=(*melody.notes, bass),
        pedal=(PedalEvent(2.05, 127), PedalEvent(5.0, 0)),
        bars=(Bar(0.0, 1), Bar(2.1, 2)),
    )
    shorter = -np.interp(0.1, [0.03, 0.2], [0, 11]) * 1.5e-3
    result = performed(score, only("duration_contrast"))
    moved = next(note for note in result.notes if note.pitch == 40)
    assert (moved.start, moved.end) == pytest.approx((1.5, 2.05 + shorter / 2))
    assert [event.time for event in result.pedal] == pytest.approx(
        [2.05 + shorter / 2, 5 + shorter]
    )
    assert [bar.time for bar in result.bars] == pytest.approx([0, 2.1 + shorter])


def test_a_scale_is_played_louder_as_it_rises_and_slower_at_its_end():
    result = performed(SCALE)
    assert velocities(result)[6] > velocities(result)[0]
    assert intervals(result)[-1] > 2 * intervals(result)[5]
    assert result.notes[0].start == SCALE.notes[0].start


def test_a_chorale_keeps_its_notes_and_gets_dynamics():
    result = performed(CHORALE)
    assert sorted(n.pitch for n in result.notes) == sorted(n.pitch for n in CHORALE.notes)
    assert len(set(velocities(result))) > 5
    assert CHORALE.total_time < result.total_time < 1.5 * CHORALE.total_time


def test_time_grows_with_the_music():
    def seconds(count):
        music = line([60 + k % 24 for k in range(count)], [0.05] * count)
        begun = time.process_time()
        performed(music)
        return time.process_time() - begun

    seconds(1000)
    assert seconds(20_000) < 40 * max(seconds(2_000), 1e-3)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), "much"])
def test_quantities_are_checked(value):
    with pytest.raises(CadenzaError, match="dose"):
        performed(SCALE, ExpressionConfig(dose=value))


def test_an_arrangement_with_expression_is_the_performed_score() -> None:
    written = Arrangement().score("OdeToJoy")
    dose = 0.5
    expected = performed(written, ExpressionConfig(dose=dose))
    assert Arrangement(expression=dose).score("OdeToJoy") == expected != written


def test_expression_out_of_range_is_refused() -> None:
    with pytest.raises(CadenzaError, match="expression -1: choose 0 to 10"):
        Arrangement(expression=-1)
