import json
import tracemalloc
from pathlib import Path

import mir_eval
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.music.goals import score_to_goals
from cadenza.music.metrics import note_errors, playing_metrics, step_metrics
from cadenza.music.performance import performed_score
from cadenza.music.score import Note, Score

DATA = Path(__file__).parents[1] / "data"
STILL = np.zeros(40, bool)


def of_rolls(played, sustain, goal, goal_sustain, dt):
    """Of a score whose notes begin and end on steps as those of the goal do."""
    score = performed_score(goal, goal_sustain, dt)
    return playing_metrics(played, sustain, goal, goal_sustain, dt, score)


@pytest.mark.parametrize("episode", "abcd")
def test_metrics_are_those_recorded_from_the_published_system(episode):
    with np.load(DATA / f"episode_{episode}.npz") as recorded:
        observed = np.concatenate([recorded["goal_obs0"][None], recorded["goal_obs"][:-1]])
        metrics = of_rolls(
            recorded["key_activation"],
            recorded["sustain_activation"],
            observed[:, :88],
            observed[:, 88],
            float(recorded["dt"]),
        )
        expected = json.loads(str(recorded["metrics"]))
    assert {name: metrics[name] for name in expected} == pytest.approx(expected, abs=1e-9)


def roll(*notes: tuple[int, int, int]):
    keys = np.zeros((40, 88), bool)
    for first, last, key in notes:
        keys[first:last, key] = True
    return keys


def test_step_metrics_by_hand():
    goal = roll((0, 3, 10), (1, 3, 20))
    played = roll((0, 2, 10), (1, 2, 30), (3, 4, 40))
    precision, recall, f1 = step_metrics(played[:5], goal[:5])
    np.testing.assert_allclose(precision, [1, 0.5, 1, 0, 1])
    np.testing.assert_allclose(recall, [1, 0.5, 0, 1, 1])
    np.testing.assert_allclose(f1, [1, 0.5, 0, 0, 1])


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.02, 0.3]), st.sampled_from([0.0, 0.1]))
def test_pooled_metrics_count_the_hits_of_all_steps(seed, density, goal_density):
    rng = np.random.default_rng(seed)
    played, goal = rng.random((40, 88)) < density, rng.random((40, 88)) < goal_density
    hits = misses = extra = 0
    for step in range(40):
        for key in range(88):
            hits += bool(played[step, key] and goal[step, key])
            misses += bool(goal[step, key] and not played[step, key])
            extra += bool(played[step, key] and not goal[step, key])
    expected = {
        "pooled_precision": hits / (hits + extra) if hits + extra else 1.0,
        "pooled_recall": hits / (hits + misses) if hits + misses else 1.0,
        "pooled_f1": 2 * hits / (2 * hits + misses + extra) if hits + misses + extra else 1.0,
    }
    metrics = playing_metrics(played, STILL, goal, STILL, 0.05, Score(()))
    assert {name: metrics[name] for name in expected} == pytest.approx(expected)


def note_f1(played, goal):
    metrics = of_rolls(played, STILL, goal, STILL, 0.05)
    return metrics["note_onset_f1"], metrics["note_onset_offset_f1"]


def test_notes_count_as_found_by_key_onset_and_offset():
    goal = roll((0, 10, 10), (20, 30, 12))
    assert note_f1(goal, goal) == (1, 1)
    # One step late is within 50 ms, two are not; the second note's key is wrong.
    assert note_f1(roll((1, 10, 10), (20, 30, 13)), goal) == (0.5, 0.5)
    assert note_f1(roll((2, 10, 10), (20, 30, 13)), goal) == (0, 0)
    # Two steps short of ten are a fifth of the length; three are too much.
    assert note_f1(roll((0, 8, 10), (20, 27, 12)), goal) == (1, 0.5)
    # A note found, another invented: precision 1/2, recall 1/2; then precision 2/3, recall 1.
    assert note_f1(roll((0, 10, 10), (20, 30, 12), (35, 38, 50)), goal)[0] == pytest.approx(0.8)


def test_a_key_held_through_a_repeated_note_is_one_note_too_few():
    goal = roll((0, 10, 10), (11, 20, 10))
    held, _ = note_f1(roll((0, 20, 10)), goal)
    assert held == pytest.approx(2 / 3)


def timing_error(played, goal):
    return of_rolls(played, STILL, goal, STILL, 0.05)["timing_error"]


def test_the_timing_error_is_the_mean_distance_of_beginnings():
    goal = roll((5, 15, 10), (20, 30, 12))
    assert timing_error(goal, goal) == 0
    # One 0.15 s late, the other 0.05 s early; how they end does not matter.
    assert timing_error(roll((8, 10, 10), (19, 40, 12)), goal) == pytest.approx(0.1)
    # Further than 0.2 s away it is another note, and so is another key.
    assert timing_error(roll((10, 15, 10), (22, 30, 12)), goal) == pytest.approx(0.1)
    assert timing_error(roll((20, 30, 12), (5, 15, 11)), goal) == 0
    assert np.isnan(timing_error(roll((5, 15, 11)), goal))
    assert np.isnan(timing_error(roll(), goal))


def of_goals(score, played=None, shorten=False, dt=0.05):
    """Of the goals played to the letter, or of other goals."""
    goals = score_to_goals(score, dt, shorten)
    keys = goals.keys if played is None else played
    return playing_metrics(keys, goals.sustain, goals.keys, goals.sustain, dt, score)


def test_a_repeated_note_that_begins_a_step_late_is_late():
    score = Score((Note(0, 0.5, 60), Note(0.5, 1, 60), Note(1, 1.5, 60), Note(1.5, 2, 62)))
    late = of_goals(score)
    assert (late["f1"], late["note_onset_f1"]) == (1, 1)
    assert late["timing_error"] == pytest.approx(2 * 0.05 / 4)
    in_time = of_goals(score, shorten=True)
    assert (in_time["f1"], in_time["note_onset_f1"], in_time["timing_error"]) == (1, 1, 0)


def test_a_step_late_counts_on_every_step_and_two_do_not():
    score = Score(tuple(Note(t, t + 1.5, 60) for t in np.arange(0, 600, 2.35)))
    score = score.with_initial_silence(0.35)
    goal = score_to_goals(score, 0.05).keys
    assert of_goals(score, np.roll(goal, 1, axis=0))["note_onset_f1"] == 1
    assert of_goals(score, np.roll(goal, 2, axis=0))["note_onset_f1"] == 0
    assert of_goals(score, np.roll(goal, 1, axis=0))["timing_error"] == pytest.approx(0.05)


def test_notes_between_steps_are_as_far_off_as_the_score_has_them():
    score = Score((Note(0.02, 0.5, 60), Note(0.54, 0.9, 62)))
    assert of_goals(score)["timing_error"] == pytest.approx((0.02 + 0.04) / 2)


def test_notes_that_begin_after_the_end_are_not_missed():
    score = Score((Note(0, 0.5, 60), Note(0.5, 1, 62)))
    goals = score_to_goals(score, 0.05)
    keys, sustain = goals.keys[:10], goals.sustain[:10]
    result = playing_metrics(keys, sustain, keys, sustain, 0.05, score)
    assert (result["note_onset_f1"], result["note_onset_offset_f1"]) == (1, 1)


def test_silence_against_silence_is_perfect_and_against_notes_is_nothing():
    some = roll((0, 10, 10))
    assert note_f1(roll(), roll()) == (1, 1)
    assert note_f1(roll(), some) == (0, 0)
    assert note_f1(some, roll()) == (0, 0)


def by_mir_eval(played, goal):
    def notes(keys):  # step by step, for mir_eval's own multipitch-free interface
        played_notes, since = [], {}
        for t in range(len(keys) + 1):
            for k in range(88):
                on = t < len(keys) and keys[t, k]
                if on and k not in since:
                    since[k] = t
                elif not on and k in since:
                    played_notes.append((since.pop(k) * 0.05, t * 0.05, 27.5 * 2 ** (k / 12)))
        table = np.array(sorted(played_notes))
        return table[:, :2], table[:, 2]

    (times, pitches), sounded = notes(goal), notes(played)
    target = np.round(times, 9), pitches  # as scores have them
    expected = mir_eval.transcription.evaluate(*target, *sounded)
    pairs = mir_eval.transcription.match_notes(
        *target, *sounded, onset_tolerance=0.2, offset_ratio=None
    )
    errors = [abs(target[0][i, 0] - sounded[0][j, 0]) for i, j in pairs]
    return {
        "note_onset_f1": expected["F-measure_no_offset"],
        "note_onset_offset_f1": expected["F-measure"],
        "timing_error": np.mean(errors) if errors else np.nan,
    }


def note_metrics(played, goal):
    still = np.zeros(len(played), bool)
    metrics = of_rolls(played, still, goal, still, 0.05)
    return {
        name: metrics[name] for name in ("note_onset_f1", "note_onset_offset_f1", "timing_error")
    }


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=30)
def test_note_metrics_are_those_of_mir_eval(seed):
    """Trills on a few keys, in which many notes could be many others."""
    rng = np.random.default_rng(seed)
    goal = np.zeros((120, 88), bool)
    goal[:, rng.choice(88, 4)] = rng.random((120, 4)) < rng.choice([0.1, 0.5, 0.8])
    played = np.roll(goal, rng.integers(4), axis=0) ^ (goal & (rng.random(goal.shape) < 0.2))
    played[0, 40] = goal[0, 40] = True
    assert note_metrics(played, goal) == pytest.approx(by_mir_eval(played, goal), nan_ok=True)


def test_note_metrics_of_five_minutes_take_little_memory():
    rng = np.random.default_rng(0)
    goal = np.zeros((6_000, 88), bool)
    goal[np.arange(6_000), np.repeat(rng.integers(88, size=3_000), 2)] = True
    goal[:, 40] = np.arange(6_000) % 2
    tracemalloc.start()
    metrics = note_metrics(np.roll(goal, 1, axis=0), goal)
    used = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert metrics["note_onset_f1"] > 0.99
    assert used < 20e6


RIGHT = Note(2.0, 3.0, 60)


def kinds(written, played):
    """The kinds of errors, and the pitches of their notes."""
    _, *errors = note_errors(written, played)
    return {
        kind: [note.pitch for note in notes]
        for group in errors
        for kind, notes in group._asdict().items()
        if notes
    }


@pytest.mark.parametrize(
    ("played", "expected"),
    [
        ([Note(2.05, 3, 60)], {}),
        ([], {"silent": [60]}),
        ([Note(1.5, 2.5, 60)], {"held": [60], "other": [60]}),
        ([Note(1.0, 1.9, 60)], {"silent": [60], "other": [60]}),
        ([RIGHT, Note(2.5, 2.9, 60)], {"again": [60]}),
        ([RIGHT, Note(3.1, 3.2, 60)], {"again": [60]}),
        ([RIGHT, Note(3.3, 3.4, 60)], {"other": [60]}),
        ([RIGHT, Note(1.9, 1.94, 62)], {"neighbour": [62]}),
        ([RIGHT, Note(2.5, 2.54, 59)], {"neighbour": [59]}),
        ([RIGHT, Note(2.0, 2.04, 63)], {"other": [63]}),
        ([RIGHT, Note(3.2, 3.24, 61)], {"other": [61]}),
        ([Note(2.0, 3, 61)], {"silent": [60], "neighbour": [61]}),
    ],
)
def test_kinds_of_errors_by_hand(played, expected):
    assert kinds([RIGHT], played) == expected


def test_a_late_note_is_missed_and_extra():
    errors = note_errors([RIGHT], [late := Note(2.06, 3, 60)])
    assert (errors.missed.off_time, errors.extra.off_time, errors.pairs) == ([RIGHT], [late], [])


def test_a_late_repetition_is_not_taken_for_the_note_before():
    written = [Note(1.0, 1.2, 60), Note(1.3, 1.5, 60)]
    assert kinds(written, [Note(1.02, 1.2, 60), Note(1.4, 1.5, 60)]) == {"off_time": [60]}


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_notes_are_right_as_in_mir_eval_and_all_others_have_one_kind(seed):
    rng = np.random.default_rng(seed)

    def notes(count):
        starts = rng.integers(0, 100, count) / 25  # never 50 ms apart, which rounding decides
        return [Note(start, start + 0.1, 60 + int(rng.integers(5))) for start in starts]

    written, played = notes(20), notes(25)
    arrays = (
        array
        for side in (written, played)
        for array in (
            np.array([(note.start, note.end) for note in side]),
            440 * 2 ** ((np.array([note.pitch for note in side]) - 69) / 12),
        )
    )
    matches = mir_eval.transcription.match_notes(*arrays, onset_tolerance=0.05, offset_ratio=None)
    errors = note_errors(written, played)
    assert len(errors.pairs) == len(matches)
    for group, side, place in ((errors.missed, written, 0), (errors.extra, played, 1)):
        others = [id(note) for notes in group for note in notes]
        assert sorted(others + [id(pair[place]) for pair in errors.pairs]) == sorted(map(id, side))
