import time

import mir_eval
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cadenza.music.metrics import expressive_metrics
from cadenza.music.score import Note, Score

TIMING = (
    "onset_delay",
    "onset_error_median",
    "onset_error_90",
    "ioi_error_median",
    "ioi_error_90",
    "chord_spread_median",
    "chord_spread_90",
    "duration_error_median",
)


def score(*notes):
    return Score(tuple(Note(*note) for note in notes))


WRITTEN = score((1, 2, 60, 40), (1, 2, 64, 60), (2, 3, 62, 80), (3, 4, 64, 100))


def test_what_is_written_is_perfect():
    metrics = expressive_metrics(WRITTEN, WRITTEN)
    assert {metrics[name] for name in TIMING} == {0}
    assert metrics["velocity_error"] == metrics["velocity_error_with_misses"] == 0
    assert metrics["velocity_correlation"] == pytest.approx(1)
    assert metrics["note_onset_f1"] == metrics["note_onset_velocity_f1"] == 1
    assert metrics["extra_notes_per_100"] == metrics["missed_notes_per_100"] == 0
    assert metrics["onset_f1_times_velocity_accuracy"] == 1


def test_a_constant_delay_is_told_apart_from_errors():
    played = score((1.03, 2, 60), (1.03, 2, 64), (2.03, 3, 62), (3.04, 4, 64))
    metrics = expressive_metrics(played, WRITTEN)
    assert metrics["onset_delay"] == pytest.approx(0.03)
    assert metrics["onset_error_median"] == pytest.approx(0)
    assert metrics["onset_error_90"] == pytest.approx(np.percentile([0, 0, 0, 0.01], 90))


def test_intervals_chords_and_durations_by_hand():
    played = score((1.00, 1.9, 60), (1.02, 2.0, 64), (2.03, 3, 62), (3.00, 4.5, 64))
    metrics = expressive_metrics(played, WRITTEN)
    # The chord is at 1.01: intervals of 1.02 s and 0.97 s instead of 1 s.
    assert metrics["ioi_error_median"] == pytest.approx(0.025)
    assert metrics["ioi_error_90"] == pytest.approx(0.029)
    assert metrics["chord_spread_median"] == pytest.approx(0.02)
    assert metrics["duration_error_median"] == pytest.approx((0.03 + 0.1) / 2)


def test_velocities_by_hand():
    played = score((1, 2, 60, 50), (1, 2, 64, 60), (2, 3, 62, 77))
    metrics = expressive_metrics(played, WRITTEN)
    assert metrics["velocity_error"] == pytest.approx((10 + 0 + 3) / 3)
    assert metrics["velocity_error_with_misses"] == pytest.approx((10 + 0 + 3 + 100) / 4)
    assert metrics["velocity_correlation"] == pytest.approx(
        np.corrcoef([50, 60, 77], [40, 60, 80])[0, 1]
    )
    assert metrics["note_onset_f1"] == pytest.approx(6 / 7)
    assert metrics["onset_f1_times_velocity_accuracy"] == pytest.approx(6 / 7 * (1 - 13 / 3 / 127))


def test_a_missed_repetition_does_not_shift_the_notes_after_it():
    written = score(*((k * 0.15, k * 0.15 + 0.1, 60) for k in range(1, 20)))
    metrics = expressive_metrics(Score(written.notes[1:]), written)
    assert metrics["onset_error_90"] == 0


def test_velocities_that_do_not_vary_have_no_correlation():
    played = score((1, 2, 60, 70), (1, 2, 64, 70), (2, 3, 62, 70))
    assert expressive_metrics(played, WRITTEN)["velocity_correlation"] is None
    assert expressive_metrics(WRITTEN, played)["velocity_correlation"] is None


def test_no_notes():
    metrics = expressive_metrics(Score(()), Score(()))
    assert metrics.pop("note_onset_f1") == metrics.pop("note_onset_velocity_f1") == 1
    assert metrics.pop("onset_f1_times_velocity_accuracy") == 1
    assert set(metrics.values()) == {None}


def test_one_note():
    metrics = expressive_metrics(score((1.01, 2, 60, 70)), score((1, 2, 60, 80)))
    assert metrics["onset_delay"] == pytest.approx(0.01)
    assert metrics["onset_error_median"] == 0
    assert metrics["ioi_error_median"] is metrics["chord_spread_90"] is None
    assert metrics["velocity_correlation"] is None
    assert (metrics["velocity_error"], metrics["note_onset_velocity_f1"]) == (10, 1)


def test_notes_are_extra_or_missed_per_hundred_that_are_written():
    metrics = expressive_metrics(score((1, 2, 60), (1.1, 2, 64), (2, 3, 63)), WRITTEN)
    assert (metrics["extra_notes_per_100"], metrics["missed_notes_per_100"]) == (50, 75)


def test_kinds_of_wrong_notes_per_hundred_that_are_written():
    played = score((1, 2, 60), (1.1, 2, 64), (2, 2.05, 61), (3, 3.2, 64), (3.4, 4, 64), (5, 6, 90))
    metrics = expressive_metrics(played, WRITTEN)
    kinds = {name: value for name, value in metrics.items() if name.endswith("_per_100")}
    assert {name: value for name, value in kinds.items() if value} == {
        **{"extra_notes_per_100": 100, "missed_notes_per_100": 50},
        **{"extra_off_time_per_100": 25, "extra_neighbour_per_100": 25},
        **{"extra_brushed_per_100": 25, "extra_again_per_100": 25, "extra_other_per_100": 25},
        **{"missed_off_time_per_100": 25, "missed_silent_per_100": 25},
    }


@pytest.mark.parametrize("played", [Score(()), score((1, 2, 61), (2.3, 3, 62))])
def test_all_missed(played):
    metrics = expressive_metrics(played, WRITTEN)
    assert {metrics[name] for name in (*TIMING, "velocity_error")} == {None}
    assert metrics["velocity_error_with_misses"] == pytest.approx((40 + 60 + 80 + 100) / 4)
    assert metrics["note_onset_f1"] == metrics["note_onset_velocity_f1"] == 0
    assert metrics["onset_f1_times_velocity_accuracy"] == 0


def arrays(notes):
    intervals = np.array([(n.start, n.end) for n in notes])
    return (
        intervals,
        440 * 2 ** ((np.array([n.pitch for n in notes]) - 69) / 12),
        np.array([n.velocity for n in notes]),
    )


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.01, 0.04, 0.1]))
def test_note_f1_is_that_of_mir_eval(seed, jitter):
    """Notes of a pitch are far apart, so that there is only one largest matching."""
    rng = np.random.default_rng(seed)
    starts = [
        (0.5 * k + rng.uniform(0.15, 0.25), pitch)
        for k in range(10)
        for pitch in rng.choice(np.arange(50, 70, 2), 3, replace=False)
    ]
    written = [Note(s, s + 0.2, int(p), int(rng.integers(20, 110))) for s, p in starts]
    played = [
        Note(
            (start := n.start + rng.uniform(-jitter, jitter)),
            start + 0.1,
            n.pitch + int(rng.random() < 0.1),
            int(np.clip(0.7 * n.velocity + 20 + rng.normal(0, 8), 1, 127)),
        )
        for n in written
        if rng.random() < 0.9
    ]
    metrics = expressive_metrics(Score(tuple(played)), Score(tuple(written)))
    expected, sounded = arrays(written), arrays(played)
    *_, onset_f1, _ = mir_eval.transcription.precision_recall_f1_overlap(
        *expected[:2], *sounded[:2], offset_ratio=None
    )
    *_, velocity_f1, _ = mir_eval.transcription_velocity.precision_recall_f1_overlap(
        *expected, *sounded, offset_ratio=None
    )
    assert metrics["note_onset_f1"] == pytest.approx(onset_f1)
    assert metrics["note_onset_velocity_f1"] == pytest.approx(velocity_f1)


def test_time_grows_with_the_music_and_not_its_square():
    def seconds(count):
        music = score(*((k * 0.01, k * 0.01 + 0.005, 60) for k in range(count)))
        begun = time.process_time()
        expressive_metrics(music, music)
        return time.process_time() - begun

    seconds(1000)
    assert seconds(40_000) < 40 * max(seconds(4_000), 1e-3)
