"""Statistics over runs and pieces, against plain loops, SciPy and figures worked out by hand."""

import math
import random

import numpy as np
import pytest
from scipy import stats

from cadenza.evaluation.statistics import bootstrap_interval, mean, mean_interval

NAN = math.nan
RAGGED = np.array([[0.1, 0.5, NAN, 0.9], [0.3, NAN, 0.6, 1.0], [0.2, NAN, 0.7, 0.8]])


def random_scores(seed: int, runs: int = 4, pieces: int = 7) -> np.ndarray:
    """Returns scores with some runs missing, but one of every piece."""
    rng = np.random.default_rng(seed)
    scores = rng.random((runs, pieces))
    scores[1:][rng.random((runs - 1, pieces)) < 0.3] = NAN
    return scores


def of_each_piece(scores: np.ndarray) -> list[list[float]]:
    return [[x for x in piece if not math.isnan(x)] for piece in scores.T.tolist()]


def test_every_piece_counts_the_same_in_the_mean():
    assert mean(RAGGED) == pytest.approx((0.2 + 0.5 + 0.65 + 0.9) / 4)


def test_the_bootstrap_interval_is_that_of_a_plain_loop():
    scores, draw, resamples = random_scores(3), random.Random(0), 4000
    drawn = sorted(
        np.mean([np.mean(draw.choices(piece, k=len(piece))) for piece in of_each_piece(scores)])
        for _ in range(resamples)
    )
    low, high = bootstrap_interval(scores)
    assert low == pytest.approx(drawn[round(0.025 * resamples)], abs=0.01)
    assert high == pytest.approx(drawn[round(0.975 * resamples)], abs=0.01)


def test_runs_are_drawn_within_their_piece():
    """Pieces differ here and their runs hardly do: drawing other pieces would change a figure."""
    scores = np.tile([0.1, 0.5, 0.9], (3, 1)) + np.array([[-1e-9], [0], [1e-9]])
    low, high = bootstrap_interval(scores)
    assert low == pytest.approx(high) == pytest.approx(0.5)


def test_single_runs_have_no_interval():
    scores = np.array([[0.2, 0.8]])
    assert np.isnan(bootstrap_interval(scores)).all()
    assert np.isnan(mean_interval(scores)[1:]).all()
    assert mean_interval(scores)[0].tolist() == [0.2, 0.8]


def test_runs_that_are_all_the_same_have_no_interval():
    scores = np.array([[0.2, 0.8], [0.2, 0.8], [math.nan, 0.8]])
    assert np.isnan(bootstrap_interval(scores)).all()
    scores[0, 0] = 0.3
    assert not np.isnan(bootstrap_interval(scores)).any()
    _, low, high = mean_interval(scores)
    assert np.isnan(low).tolist() == np.isnan(high).tolist() == [False, True]


def test_the_interval_of_a_piece_is_student_s():
    middle, low, high = mean_interval(RAGGED)
    # Of 0.1 0.2 0.3: s = 0.1, and t of 97.5 % with two degrees of freedom is 4.3027.
    assert middle[0] == pytest.approx(0.2)
    assert high[0] - middle[0] == pytest.approx(4.3027 * 0.1 / math.sqrt(3), rel=1e-4)
    assert math.isnan(low[1])
    for piece, runs in enumerate(of_each_piece(RAGGED)):
        if len(runs) > 1:
            theirs = stats.t.interval(0.95, len(runs) - 1, np.mean(runs), stats.sem(runs))
            assert (low[piece], high[piece]) == pytest.approx(theirs)
