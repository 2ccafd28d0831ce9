import numpy as np
import pytest
from hypothesis import given

from cadenza.episode import Episode
from cadenza.music.goals import score_to_goals
from cadenza.music.performance import KeyEvent, key_events, performed_score, played_in
from cadenza.music.score import Note, PedalEvent
from music_strategies import scores

DT = 0.05


def silent(steps):
    return np.zeros((steps, 88), bool), np.zeros(steps, bool)


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


NAN = np.nan


def sounded(*events, steps=10, dt=DT):
    keys, sustain = silent(steps)
    events = (KeyEvent(*event) for event in events)
    return [
        (note.start, note.end, note.pitch, note.velocity)
        for note in performed_score(keys, sustain, dt, events).notes
    ]


def test_notes_begin_and_end_when_keys_do():
    assert sounded((2, 39, 0.013, NAN, 64), (3, 60, 0.001, NAN, 90), (4, 39, NAN, 0.03, NAN)) == [
        (0.113, 0.23, 60, 64),
        (0.151, 0.5, 81, 90),  # until the end
    ]


def test_a_key_struck_again_within_a_step_is_two_notes():
    assert sounded((1, 0, 0.01, NAN, 50), (3, 0, 0.04, 0.01, 70)) == [
        (0.06, 0.16, 21, 50),
        (0.19, 0.5, 21, 70),
    ]


def test_a_key_that_sounds_only_within_a_step_is_a_note():
    assert sounded((1, 0, 0.01, 0.03, 50)) == [(0.06, 0.08, 21, 50)]


@pytest.mark.parametrize(
    "bounce",
    [
        [(2, 0, 0.03, 0.015, 10)],  # within a step
        [(2, 0, NAN, 0.045, NAN), (3, 0, 0.01, NAN, 10)],  # from one to the next
    ],
)
def test_a_bounce_is_one_note(bounce):
    struck, lifted = (1, 0, 0.01, NAN, 50), (5, 0, NAN, 0.02, NAN)
    assert sounded(struck, *bounce, lifted) == [(0.06, 0.27, 21, 50)]


def test_a_key_that_already_sounds_does_not_begin_again():
    """Of several onsets and offsets in a step, only the last ones are known."""
    assert sounded((1, 0, 0.01, NAN, 50), (2, 0, 0.02, 0.04, 70)) == [(0.06, 0.14, 21, 50)]


def test_events_of_arrays_come_in_the_order_of_steps():
    onset, offset, velocity = np.full((3, 4, 88), np.nan)
    onset[1, 5], velocity[1, 5], offset[3, 5] = 0.02, 60, 0.01
    onset[0, 7], velocity[0, 7] = 0.03, 70
    events = list(key_events(onset, offset, velocity))
    assert [event[:2] for event in events] == [(0, 7), (1, 5), (3, 5)]
    assert (events[1].onset, events[1].velocity, events[2].offset) == (0.02, 60, 0.01)


def test_an_episode_without_times_has_notes_on_steps():
    keys, sustain = silent(10)
    keys[2:5, 39] = True
    arrays = {"action": np.zeros((10, 1)), "key_activation": keys, "sustain_activation": sustain}
    assert played_in(Episode("", DT, arrays, {})).notes == (Note(0.1, 0.25, 60, 80),)


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
