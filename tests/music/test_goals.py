import json
from math import ceil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.errors import CadenzaError
from cadenza.music.goals import held_pedal_changes, merged_notes, score_to_goals
from cadenza.music.performance import key_runs
from cadenza.music.score import Note, PedalEvent, Score
from music_strategies import scores, seconds
from numbered import FIVE, finger, recorded_note

SONGS = json.loads((Path(__file__).parents[1] / "data/songs.json").read_text())


def score_of(song: dict) -> Score:
    return Score(
        tuple(recorded_note(*values) for values in song["notes"]),
        tuple(PedalEvent(*values) for values in song["sustain_cc64"]),
    )


@pytest.mark.parametrize("name", SONGS)
def test_goals_are_those_recorded_from_the_published_system(name):
    song = SONGS[name]
    goals = score_to_goals(score_of(song), 0.05, hands=FIVE)
    assert goals.num_steps == len(song["steps_at_0.05s"])
    for t, expected in enumerate(song["steps_at_0.05s"]):
        keys = np.flatnonzero(goals.keys[t])
        assert [[k, goals.fingers[t, k]] for k in keys] == sorted(expected)
    np.testing.assert_array_equal(goals.sustain, np.array(song["sustain_at_0.05s"], bool))


def goals_by_loop(score: Score, dt: float):
    """The rules of the published system, one step, one key and one event at a time."""
    fps = 1 / dt
    steps = int(score.total_time * fps + 1)
    keys, fingers, sustain = [], [], []
    pedal = False
    for t in range(steps):
        sounding, struck, of = set(), set(), {}
        before = set()
        for note in score.notes:
            first = int(note.start * fps)
            last = max(first + 1, ceil(note.end * fps))
            if first <= t < last:
                sounding.add(note.pitch - 21)
                of[note.pitch - 21] = FIVE.number(note.finger)
            if first == t:
                struck.add(note.pitch - 21)
            if first <= t - 1 < last:
                before.add(note.pitch - 21)
        expected = sounding - (struck & before)
        keys.append([k in expected for k in range(88)])
        fingers.append([of[k] if k in expected else -1 for k in range(88)])
        for event in score.pedal:
            if int(event.time * fps) == t:
                pedal = event.value >= 64
        sustain.append(pedal)
    return np.array(keys), np.array(fingers), np.array(sustain)


@settings(deadline=None)
@given(st.one_of(scores(), scores(seconds)), st.sampled_from([0.05, 0.02, 0.1, 0.03]))
def test_goals_agree_with_a_plain_loop(score, dt):
    goals = score_to_goals(score, dt, hands=FIVE)
    keys, fingers, sustain = goals_by_loop(score, dt)
    np.testing.assert_array_equal(goals.keys, keys)
    np.testing.assert_array_equal(goals.fingers, fingers)
    np.testing.assert_array_equal(goals.sustain, sustain)


def test_a_key_struck_again_comes_up_for_one_step():
    score = Score((Note(0, 0.2, 60, finger=finger(1)), Note(0.2, 0.4, 60, finger=finger(2))))
    goals = score_to_goals(score, 0.05, hands=FIVE)
    assert goals.keys[:, 39].tolist() == [1, 1, 1, 1, 0, 1, 1, 1, 0]
    assert goals.fingers[:, 39].tolist() == [1, 1, 1, 1, -1, 2, 2, 2, -1]


@pytest.mark.parametrize(("apart", "merged"), [(0.1, 0), (0.08, 4), (0.05, 9)])
def test_notes_that_steps_do_not_tell_apart_are_counted(apart, merged):
    starts = [round(apart * i, 9) for i in range(10)]
    score = Score(
        tuple(Note(start, start + 0.3 * apart, pitch) for start in starts for pitch in (60, 67))
    )
    assert merged_notes(score, score_to_goals(score, 0.05)) == 2 * merged


def test_notes_of_two_voices_on_one_key_are_no_merged_ones():
    score = Score((Note(0, 0.2, 60), Note(0, 0.4, 60), Note(0.2, 0.6, 60)))
    assert merged_notes(score, score_to_goals(score, 0.05)) == 0


def test_a_pedal_that_is_lifted_and_pressed_on_one_step():
    """As published it stays down; where notes before others are shortened, it comes up."""
    moves = ((0.1, 127), (0.31, 0), (0.32, 127), (0.4, 0), (0.6, 0), (0.61, 100))
    score = Score((Note(0, 0.9, 60),), tuple(PedalEvent(*move) for move in moves))
    published, shortened = (
        score_to_goals(score, 0.05, shorten).sustain for shorten in (False, True)
    )
    assert published.tolist() == [0, 0, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1]
    assert np.flatnonzero(published != shortened).tolist() == [6]
    assert held_pedal_changes(score, 0.05, published) == 1
    assert held_pedal_changes(score, 0.05, shortened) == 0


def test_the_note_before_may_be_shortened_instead():
    score = Score((Note(0, 0.2, 60, finger=finger(1)), Note(0.2, 0.4, 60, finger=finger(2))))
    goals = score_to_goals(score, 0.05, shorten=True, hands=FIVE)
    assert goals.keys[:, 39].tolist() == [1, 1, 1, 0, 1, 1, 1, 1, 0]
    assert goals.fingers[:, 39].tolist() == [1, 1, 1, -1, 2, 2, 2, 2, -1]


@settings(deadline=None)
@given(st.one_of(scores(), scores(seconds)))
def test_shortening_leaves_something_of_every_note_and_moves_but_one_step_of_each(score):
    published, shortened = (score_to_goals(score, 0.05, shorten) for shorten in (False, True))
    assert len(key_runs(published.keys)[0]) <= len(key_runs(shortened.keys)[0])
    assert published.keys.sum() == shortened.keys.sum()
    struck = np.zeros_like(published.keys)
    for note in score.notes:
        struck[int(note.start * 20), note.pitch - 21] = True
    late = struck & ~shortened.keys
    assert (late <= struck & ~published.keys).all()
    # Only where the note before has but one step left.
    for step, key in np.argwhere(late):
        assert struck[step - 1, key] or not shortened.keys[step - 2, key]


def test_the_pedal_holds_between_its_events():
    score = Score((Note(0, 0.4, 60),), (PedalEvent(0.1, 64), PedalEvent(0.26, 63)))
    assert score_to_goals(score, 0.05).sustain.tolist() == [0, 0, 1, 1, 1, 0, 0, 0, 0]


def test_arrays_have_the_documented_types():
    goals = score_to_goals(Score((Note(0, 1, 60),)), 0.05)
    assert goals.keys.shape == goals.fingers.shape == (21, 88)
    assert (goals.keys.dtype, goals.fingers.dtype, goals.sustain.dtype) == (bool, np.int8, bool)


def test_an_empty_score_is_refused():
    with pytest.raises(CadenzaError, match="no notes"):
        score_to_goals(Score(()), 0.05)


@pytest.mark.parametrize("dt", [0, -0.05, float("nan"), float("inf")])
def test_the_step_must_be_a_positive_time(dt):
    with pytest.raises(CadenzaError, match="control step"):
        score_to_goals(Score((Note(0, 1, 60),)), dt)
