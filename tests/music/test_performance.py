from pathlib import Path

import numpy as np
import pytest
from hypothesis import given

from cadenza.keyboards.piano import PIANO
from cadenza.music.formats.midi import read_midi, write_midi
from cadenza.music.goals import score_to_goals
from cadenza.music.performance import performed_score, with_velocities_of
from cadenza.music.score import Note, PedalEvent, Score
from music_strategies import scores

DT = 0.05
DATA = Path(__file__).parents[1] / "data"


def silent(steps):
    return np.zeros((steps, 88), bool), np.zeros(steps, bool)


def depth(angle):
    return np.clip(angle / PIANO.travel, 0, 1)


def test_steps_in_a_row_are_one_note():
    keys, sustain = silent(10)
    keys[2:5, 39] = keys[6:10, 39] = True
    keys[0, 87] = True
    assert performed_score(keys, sustain, 0.25).notes == (
        Note(0.0, 0.25, 108),
        Note(0.5, 1.25, 60),
        Note(1.5, 2.5, 60),
    )


@pytest.mark.parametrize("dt", [0.05, 0.025, 0.1])
def test_goals_of_what_was_played_are_the_same_steps(dt):
    keys = np.random.default_rng(0).random((2000, 88)) < 0.5
    keys[-1] = False
    score = performed_score(keys, keys[:, 0], dt)
    again = score_to_goals(score, dt)
    steps = again.num_steps
    assert steps in (1999, 2000)
    np.testing.assert_array_equal(again.keys, keys[:steps])
    np.testing.assert_array_equal(again.sustain, keys[:steps, 0])


def test_the_pedal_is_written_where_it_moves():
    keys, sustain = silent(10)
    sustain[3:5] = sustain[7:] = True
    assert performed_score(keys, sustain, 0.25).pedal == (
        PedalEvent(0.75, 127),
        PedalEvent(1.25, 0),
        PedalEvent(1.75, 127),
    )


def test_silence_is_a_score_without_notes():
    score = performed_score(*silent(5), DT)
    assert score.notes == ()
    assert score.pedal == ()


@pytest.mark.parametrize("key", [39, 40])  # C4, C#4
@pytest.mark.parametrize(
    ("seconds_down", "velocity"), [(0.05, 120), (0.1, 120), (0.2, 75), (0.4, 52)]
)
def test_velocity_follows_the_speed_of_the_key(key, seconds_down, velocity):
    travel = PIANO.travel[key]
    steps = round(seconds_down / DT)
    angle = np.zeros((20, 88))
    angle[5:, key] = travel
    angle[4 : 4 + steps + 1, key] = np.linspace(0, travel, steps + 1)
    keys = angle >= travel - 1e-9
    score = performed_score(keys, np.zeros(20, bool), DT, depth(angle))
    assert abs(score.notes[0].velocity - velocity) <= 1


def test_a_key_that_lay_just_above_its_bottom_is_soft():
    angle = np.full((20, 88), 0.06)
    keys, sustain = silent(20)
    keys[10:, 39] = True
    assert performed_score(keys, sustain, DT, depth(angle)).notes[0].velocity == 30


def test_a_key_struck_again_soon_is_as_loud_as_its_way_from_where_it_turned():
    angle = np.zeros((20, 88))
    keys, sustain = silent(20)
    angle[5:, 39] = PIANO.travel[39]
    angle[10, 39] = 0.2 * PIANO.travel[39]
    keys[5:10, 39] = keys[11:, 39] = True
    first, again = performed_score(keys, sustain, DT, depth(angle)).notes
    assert (first.velocity, again.velocity) == (120, 102)


@pytest.mark.parametrize("name", "bcd")
def test_no_key_that_is_struck_again_in_a_recording_is_silent(name):
    with np.load(DATA / f"episode_{name}.npz") as recorded:
        keys, angle = recorded["key_activation"], recorded["key_qpos"]
    notes = performed_score(keys, np.zeros(len(keys), bool), DT, depth(angle)).notes
    again = [
        b.velocity for a in notes for b in notes if a.pitch == b.pitch and 0 < b.start - a.end < 0.1
    ]
    assert min(again) > 35


def test_the_scores_loudness_with_the_timing_that_was_played():
    score = Score((Note(0, 0.4, 60, 40), Note(0.5, 0.9, 60, 90), Note(0, 1, 64, 100)))
    played = Score(
        (
            Note(0.05, 0.3, 60),
            Note(0.4, 0.7, 60),  # the second, a little early
            Note(1.5, 1.6, 60),  # too late to be any of them
            Note(0.1, 0.2, 61),  # wrong
            Note(0.2, 0.3, 64),
        ),
        (PedalEvent(0.5, 127),),
    )
    heard = with_velocities_of(played, score)
    assert [note.velocity for note in heard.notes] == [40, 30, 100, 90, 30]
    assert performed_times(heard) == performed_times(played)
    assert heard.pedal == played.pedal


@pytest.mark.parametrize("start", [0.9, 1.35, 7.7])
def test_a_note_four_steps_late_is_still_the_same(start):
    """As for the metrics, whatever rounding makes of the difference."""
    score = Score((Note(start, start + 1, 60, 100),))
    played = Score((Note(start + 0.2, start + 1, 60, 80),))
    assert with_velocities_of(played, score).notes[0].velocity == 100


def performed_times(score):
    return [(note.start, note.end, note.pitch) for note in score.notes]


@given(scores())
def test_the_goals_played_to_the_letter_are_the_goals_again(score):
    goals = score_to_goals(score, DT)
    played = performed_score(goals.keys, goals.sustain, DT)
    # In whole steps, so that a rounded end does not reach into the next step.
    again = np.zeros_like(goals.keys)
    for note in played.notes:
        again[round(note.start / DT) : round(note.end / DT), note.pitch - 21] = True
    np.testing.assert_array_equal(again, goals.keys)
    pedal = np.zeros_like(goals.sustain)
    for event in played.pedal:
        pedal[round(event.time / DT) :] = event.value == 127
    np.testing.assert_array_equal(pedal, goals.sustain)


def test_what_was_played_goes_through_a_midi_file(tmp_path):
    keys, sustain = silent(40)
    keys[3:17, 30] = keys[10:20, 60] = True
    sustain[5:15] = True
    played = performed_score(keys, sustain, DT)
    write_midi(played, tmp_path / "played.mid")
    goals = score_to_goals(read_midi(tmp_path / "played.mid"), DT)
    np.testing.assert_array_equal(goals.keys, keys[: goals.num_steps])
    np.testing.assert_array_equal(goals.sustain, sustain[: goals.num_steps])
