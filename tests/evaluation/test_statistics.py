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
    """Scores with some runs missing, but one of every piece."""
    rng = np.random.default_rng(seed)
    scores = rng.random((runs, pieces))
    scores[1:][rng.random((runs - 1, pieces)) < 0.3] = NAN
    return scores


def of_each_piece(scores: np.ndarray) -> list[list[float]]:
    return [[x for x in piece if not math.isnan(x)] for piece in scores.T.tolist()]


def test_every_piece_counts_the_same_in_the_mean():
    assert mean(RAGGED) == pytest.approx((0.2 + 0.5 + 0.65 + 0.9) / 4)


def test_the_bootstrap_interval_is_that_of_a_plain_loop():
    scores, others, draw, resamples = random_scores(3), random_scores(4), random.Random(0), 4000
    runs, other_runs = of_each_piece(scores), of_each_piece(others)

    def drawn(piece: list[float]) -> float:
        return float(np.mean(draw.choices(piece, k=len(piece))))

    means, differences = [], []
    for _ in range(resamples):
        pieces = draw.choices(range(len(runs)), k=len(runs))
        ours = [drawn(runs[i]) for i in pieces]
        means.append(np.mean(ours))
        differences.append(np.mean([a - drawn(other_runs[i]) for a, i in zip(ours, pieces)]))  # noqa: B905
    for values, interval in (
        (means, bootstrap_interval(scores)),
        (differences, bootstrap_interval(scores, others)),
    ):
        ends = (np.quantile(values, 0.025), np.quantile(values, 0.975))
        assert interval == pytest.approx(ends, abs=0.015)


def test_differences_are_those_on_the_same_pieces():
    """Pieces differ much more here than the agents do."""
    scores = np.tile([0.1, 0.5, 0.9], (2, 1))
    low, high = bootstrap_interval(scores, scores - 0.05)
    assert low == pytest.approx(high) == pytest.approx(0.05)
    low, high = bootstrap_interval(scores)
    assert high - low > 0.5


def test_what_has_no_interval():
    single = np.array([[0.2, 0.8]])
    assert np.isnan(mean_interval(single)[1:]).all()
    assert mean_interval(single)[0].tolist() == [0.2, 0.8]
    assert np.isnan(bootstrap_interval(single[:, :1])).all()
    same = np.array([[0.3, 0.8], [0.2, 0.8], [math.nan, 0.8]])
    _, low, high = mean_interval(same)
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
