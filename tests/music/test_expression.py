import time
from dataclasses import fields, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given

from cadenza.errors import CadenzaError
from cadenza.music.arrangement import Arrangement, load_song
from cadenza.music.etudes import make_etude
from cadenza.music.expression import VELOCITY_PER_DECIBEL, performed
from cadenza.music.expression_rules import ExpressionRules
from cadenza.music.score import Bar, Note, PedalEvent, Score
from music_strategies import monophonic_per_key, scores

RULES = [f.name for f in fields(ExpressionRules)]
NONE = ExpressionRules(**dict.fromkeys(RULES, 0.0))


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


def lengthened(score, rule, unchanged=0):
    """By how much intervals get longer, at the tempo of one that the rule leaves as it is [s]."""
    played, written = intervals(performed(score, rules=only(rule))), intervals(score)
    return played * written[unchanged] / played[unchanged] - written


def softened(score, rules, unchanged=0):
    """By how much notes get softer than one that the rules leave as it is."""
    played = velocities(performed(score, rules=rules)) - velocities(score)
    return played[unchanged] - played


CHORALE = make_etude("chorale", 5, 0)
SCALE = line(range(60, 73), [0.25] * 13)


@given(scores())
def test_dose_0_is_the_score_bit_for_bit(score):
    score = replace(score, bars=(Bar(-0.5, 1), Bar(2 / 3, 2)))
    for result in (performed(score, 0.0), performed(score, rules=NONE)):
        assert result == score
        assert result.bars == score.bars


def test_no_notes():
    assert performed(Score(())) == Score(())


@given(scores().map(monophonic_per_key))
def test_keys_and_fingers_stay_and_notes_of_a_key_do_not_overlap(score):
    result = performed(score, 4.0, ExpressionRules(inegales=1.0))
    for pitch in range(128):
        before = [note for note in score.notes if note.pitch == pitch]
        after = [note for note in result.notes if note.pitch == pitch]
        assert [note.finger for note in before] == [note.finger for note in after]
        assert all(a.end <= b.start for a, b in pairwise(after))
    assert [event.value for event in result.pedal] == [event.value for event in score.pedal]
    assert performed(score, 4.0, ExpressionRules(inegales=1.0)) == result


@pytest.mark.parametrize("rule", RULES)
def test_a_rule_scales_with_the_dose(rule):
    halved = performed(CHORALE, 0.5, rules=only(rule))
    assert halved == performed(CHORALE, rules=only(rule, 0.5))


def test_high_loud_is_3_decibels_an_octave_and_moves_nothing():
    score = line([48, 60, 72], [1, 1, 1])
    result = performed(score, rules=only("high_loud"))
    assert velocities(result).tolist() == [
        64 - round(3 * VELOCITY_PER_DECIBEL),
        64,
        64 + round(3 * VELOCITY_PER_DECIBEL),
    ]
    assert [(n.start, n.end) for n in result.notes] == [(n.start, n.end) for n in score.notes]


def test_velocities_stay_in_midi():
    loud = performed(line([21, 108], [1, 1], 126), rules=only("high_loud", 10.0))
    soft = performed(line([21, 108], [1, 1], 2), rules=only("high_loud", 10.0))
    assert velocities(loud)[1] == 127
    assert velocities(soft)[0] == 1


def test_duration_contrast_shortens_notes_of_a_fifth_of_a_second_most():
    score = line([60] * 5, [0.7, 0.2, 0.4, 0.7, 0.7])
    expected = [0, -11 * 1.5e-3, -7 * 1.5e-3, 0]
    assert lengthened(score, "duration_contrast") == pytest.approx(expected)
    softer = softened(score, only("duration_contrast", 4.0))
    expected = [0, 4 * 0.075 * 11 * VELOCITY_PER_DECIBEL, 0]
    assert softer[[0, 1, 3]] == pytest.approx(expected, abs=1)


def test_double_duration_evens_out_two_to_one():
    score = line([60] * 4, [0.8, 0.8, 0.4, 0.8])
    assert lengthened(score, "double_duration") == pytest.approx([0, -0.048, 0.048])
    assert lengthened(score, "duration_contrast") == pytest.approx([0, 0, 0])


def test_faster_uphill_shortens_ascending_notes_by_2_milliseconds():
    score = line([60, 62, 64, 62, 60, 62, 60], [0.5] * 7)
    expected = [-0.002, -0.002, 0, 0, 0, 0]
    assert lengthened(score, "faster_uphill", unchanged=3) == pytest.approx(expected)


def test_phrase_arch_slows_down_and_softens_both_ends():
    score = line([60] * 22, ([0.5] * 10 + [1.5]) * 2)
    result = performed(score, rules=only("phrase_arch"))
    slower = intervals(result) / intervals(score)
    assert slower[[0, 10, 11, 14]] / slower[3] == pytest.approx([1.1, 1.2, 1.1, 1])
    softer = softened(score, only("phrase_arch"), unchanged=3) / VELOCITY_PER_DECIBEL
    assert softer[[0, 3, 10, 11, 21]] == pytest.approx([1, 0, 2, 1, 2], abs=0.4)


def test_a_phrase_ends_before_a_rest():
    written = line([60] * 20, [0.5] * 20)
    notes = list(written.notes)
    notes[9] = replace(notes[9], end=notes[9].start + 0.2)
    played = intervals(performed(replace(written, notes=tuple(notes)), rules=only("phrase_arch")))
    assert played[9] / played[10] == pytest.approx(1.2 / 1.1)
    assert played[9] == max(played)


def test_a_long_phrase_is_divided_after_its_longest_notes():
    written = line([60] * 60, ([0.4] * 14 + [0.6]) * 4)
    slower = intervals(performed(written, rules=only("phrase_arch"))) / intervals(written)
    assert slower[[14, 29, 44]] / slower.min() == pytest.approx([1.2] * 3, rel=0.01)
    assert slower[[15, 30, 45]] / slower.min() == pytest.approx([1.1] * 3, rel=0.01)
    even = line([60] * 60, [0.4] * 60)
    slower = intervals(performed(even, rules=only("phrase_arch")))
    assert np.argmin(slower) == pytest.approx(0.3 * 60, abs=1)  # it cannot be divided


def test_punctuation_pauses_after_the_longest_of_five():
    score = line([60, 62, 64, 65, 67, 69], [0.32, 0.32, 0.64, 0.32, 0.32, 0.32])
    result = performed(score, rules=only("punctuation"))
    assert lengthened(score, "punctuation") == pytest.approx([0, 0, 0.45 * 0.06, 0, 0])
    gaps = [b.start - a.end for a, b in pairwise(result.notes)]
    assert gaps == pytest.approx([0, 0, 0.06, 0, 0])
    assert (velocities(result) == 64).all()


def test_a_micropause_is_of_the_whole_chord():
    melody = line([72, 74, 76, 77, 79, 81], [0.32, 0.32, 0.64, 0.32, 0.32, 0.32])
    longest, after = melody.notes[2:4]
    chord, held = replace(longest, pitch=64), replace(longest, pitch=60, end=after.end)
    score = replace(melody, notes=(*melody.notes, chord, held))
    played = {note.pitch: note for note in performed(score, rules=only("punctuation")).notes}
    assert played[64].end == played[76].end == pytest.approx(played[77].start - 0.06)
    assert played[60].end == pytest.approx(played[77].end)


def test_punctuation_sets_leaps_apart():
    score = line([60, 62, 64, 55, 57, 59, 60], [0.4] * 7)
    result = performed(score, rules=only("punctuation"))
    gaps = [b.start - a.end for a, b in pairwise(result.notes)]
    assert gaps == pytest.approx([0, 0, 0.04, 0, 0, 0])


def test_final_ritard_ends_at_a_quarter_of_the_tempo():
    score = line([60, 62] * 100, [0.04] * 200)
    result = performed(score, rules=only("final_ritard"))
    tempo = intervals(score) / intervals(result)
    left = score.notes[-1].start - np.array([note.start for note in score.notes[:-1]])
    assert tempo[left > 1.33] == pytest.approx(1)
    assert (np.diff(tempo[left < 1.33]) < 0).all()
    # The cube of the tempo falls linearly, to 1/64.
    cubed = tempo[left < 1.33] ** 3
    assert np.diff(cubed[:-2]) == pytest.approx(np.diff(cubed)[0], rel=0.02)
    assert 1 / 4 < tempo[-1] < tempo[-2] < 1 / 2
    assert result.total_time - result.notes[-1].start == pytest.approx(1.25 * intervals(result)[-1])


@pytest.mark.parametrize("quantity", [0.2, 2.0])
def test_the_last_tempo_of_a_final_ritard_depends_on_its_quantity(quantity):
    score = line([60, 62] * 200, [0.033] * 400)
    result = performed(score, rules=only("final_ritard", quantity))
    before_last, last = (intervals(score) / intervals(result))[-2:]
    # Where the cube of the tempo is linear in written time, its end lies half an interval later.
    end = 1 / (1 + 3 * quantity)
    assert end < last < before_last
    assert last**3 - (before_last**3 - last**3) / 2 == pytest.approx(end**3, abs=0.01)


def test_a_final_ritard_slows_down_what_is_below_a_held_note():
    held = Note(1, 5, 84)
    below = line([60, 62] * 20, [0.1] * 40)
    result = performed(replace(below, notes=(held, *below.notes)), rules=only("final_ritard"))
    onsets = np.array([note.start for note in result.notes if note.pitch != 84])
    assert (np.diff(np.diff(onsets))[-10:] > 0).all()
    assert max(result.notes, key=lambda note: note.pitch).end == pytest.approx(result.total_time)


def test_a_short_last_note_stays_short():
    score = line([60] * 4, [1.0, 1.0, 1.0, 0.25])
    result = performed(score, rules=only("final_ritard"))
    slower = intervals(result)[-1] / 1.0
    assert result.notes[-1].end - result.notes[-1].start == pytest.approx(1.25 * slower * 0.25)


def test_other_notes_of_a_chord_follow_a_louder_melody():
    chord = Score((Note(1, 2, 60, 64), Note(1, 2, 64, 64), Note(1, 2, 72, 64), Note(2, 3, 71, 64)))
    result = performed(chord, rules=only("melody_lead"))
    assert [note.start for note in result.notes] == pytest.approx([1, 1.025, 1.025, 2])
    assert [note.pitch for note in result.notes] == [72, 60, 64, 71]
    assert velocities(result).tolist() == [68, 60, 60, 68]
    assert [note.end for note in result.notes] == [2, 2, 2, 3]


def test_what_is_below_the_melody_stays_even():
    melody, pattern = line([72, 74], [1.2, 1.2]), line([48, 55, 52, 55] * 4, [0.15] * 16)
    result = performed(
        replace(melody, notes=melody.notes + pattern.notes), 2.0, only("melody_lead")
    )
    below = np.diff([note.start for note in result.notes if note.pitch < 60])
    assert below == pytest.approx(0.15)


@pytest.mark.parametrize("dose", [1.0, 10.0])
def test_no_chord_is_played_after_the_next(dose):
    """A grace note begins before the notes below the one before have followed."""
    chord = [Note(1, 2, pitch) for pitch in (48, 52, 76)]
    score = Score((*chord, Note(1.035, 1.07, 77), Note(1.07, 2, 76)))
    result = performed(score, dose, only("melody_lead"))
    assert [note.pitch for note in result.notes] == [76, 48, 52, 77, 76]


def test_high_loud_keeps_the_balance_of_melody_and_accompaniment():
    melody, below = line([72, 74, 76], [1.0] * 3), line([36, 38, 40], [1.0] * 3)
    score = replace(melody, notes=melody.notes + below.notes)
    result = performed(score, rules=only("high_loud"))
    louder = round(2 / 4 * VELOCITY_PER_DECIBEL)
    assert velocities(result).tolist() == [64 - louder] * 2 + [64] * 2 + [64 + louder] * 2


@pytest.mark.parametrize("rule", [rule for rule in RULES if rule != "final_ritard"])
@pytest.mark.parametrize("dose", [1.0, 3.0])
def test_tempo_and_loudness_stay_as_written_in_the_mean(rule, dose):
    result = performed(CHORALE, dose, only(rule))
    assert result.total_time == pytest.approx(CHORALE.total_time)
    assert velocities(result).mean() == pytest.approx(velocities(CHORALE).mean(), abs=0.5)


@pytest.mark.parametrize("dose", [1.0, 3.0, 10.0])
def test_a_single_note_is_played_as_written(dose):
    score = Score((Note(0.5, 1.0, 60),))
    assert performed(score, dose) == score


def test_inegales_lengthens_the_first_of_two_eighths():
    bars = (Bar(1, 1), Bar(2, 2))
    score = line(range(60, 69), [0.25] * 9, bars=bars)
    given = 0.22 * 0.25
    played = performed(score, rules=only("inegales"))
    assert intervals(played) - 0.25 == pytest.approx([given, -given] * 4)
    without = replace(score, bars=())
    assert performed(without, rules=only("inegales")) == without


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
    slower = 2.1 / (2.1 + shorter)  # so that it takes as long
    result = performed(score, rules=only("duration_contrast"))
    moved = next(note for note in result.notes if note.pitch == 40)
    within = 1 + slower * (1.05 + shorter / 2)
    assert (moved.start, moved.end) == pytest.approx((1 + slower * 0.5, within))
    assert [event.time for event in result.pedal] == pytest.approx([within, 5])
    assert [bar.time for bar in result.bars] == pytest.approx([0, 1 + slower * (1.1 + shorter)])


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
        taken = []
        for _ in range(3):  # the least, as other tests leave garbage that is collected meanwhile
            begun = time.process_time()
            performed(music)
            taken.append(time.process_time() - begun)
        return min(taken)

    seconds(1000)
    assert seconds(20_000) < 40 * max(seconds(2_000), 1e-3)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), 10.5])
def test_quantities_are_checked(value):
    with pytest.raises(CadenzaError, match=r"expression .*: choose 0 to 10"):
        Arrangement(expression=value)
    with pytest.raises(CadenzaError, match=r"rules.phrase_arch .*: choose 0 to 10"):
        Arrangement(expression=1.0, rules=ExpressionRules(phrase_arch=value))


def test_an_arrangement_with_expression_is_the_performed_score():
    written = load_song("OdeToJoy", Arrangement())
    dose, rules = 0.5, ExpressionRules(phrase_arch=3.0)
    expected = performed(written, dose, rules)
    assert load_song("OdeToJoy", Arrangement(expression=dose, rules=rules)) == expected
    assert expected != performed(written, dose) != written


def test_a_beginning_is_that_of_the_whole_performance():
    song = load_song("OdeToJoy", Arrangement(expression=1.0))
    part = load_song("OdeToJoy", Arrangement(expression=1.0, first_seconds=5.0))
    assert part == song.beginning(5.0)


def test_rules_without_expression_are_refused():
    with pytest.raises(CadenzaError, match="give --expression 1"):
        Arrangement(rules=ExpressionRules(melody_lead=2.0))
