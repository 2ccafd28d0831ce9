"""Means and confidence intervals over the runs and pieces of agents.

After Agarwal, Schwarzer, Castro, Courville, Bellemare: Deep Reinforcement Learning at the Edge of
the Statistical Precipice, NeurIPS 2021, cited by section. Their library, rliable, depends on a
plotting stack and needs the same number of runs of every piece.

Scores are arrays `(runs, pieces)`, padded with NaN for pieces with fewer runs.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Scores = NDArray[np.float64]

CONFIDENCE = 0.95
RESAMPLES = 2000
_SEED = 0  # of the bootstrap: the same runs have the same intervals


def mean(scores: Scores) -> Scores:
    """The mean over pieces (...) of the mean over the runs of each.

    Resampled scores (..., runs, pieces) all have the same NaN.
    """
    return np.nanmean(scores, axis=-2).mean(axis=-1)


def bootstrap_interval(scores: Scores) -> tuple[float, float]:
    """Both ends of the interval of the `mean` of scores (runs, pieces).

    It is the stratified percentile bootstrap of section 4.1: the runs of each piece are resampled
    with replacement, as many as there are. It shows the variation with the seeds, for these very
    pieces. NaN if no piece has two runs that differ: nothing is random then.
    """
    if not _differ(scores).any():
        return np.nan, np.nan
    means = mean(_resampled(scores, np.random.default_rng(_SEED)))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return float(low), float(high)


def _differ(scores: Scores) -> NDArray[np.bool_]:
    """Whether some run of a piece differs from another (pieces,)."""
    lowest = np.fmin.reduce(scores, axis=0, initial=np.inf)
    return np.asarray(np.fmax.reduce(scores, axis=0, initial=-np.inf) > lowest)


def _resampled(scores: Scores, rng: np.random.Generator) -> Scores:
    """Resample scores with replacement (RESAMPLES, runs, pieces)."""
    exists = ~np.isnan(scores)
    first = np.argsort(~exists, axis=0, kind="stable")  # existing runs first
    drawn = rng.integers(np.maximum(exists.sum(axis=0), 1), size=(RESAMPLES, *scores.shape))
    run = np.take_along_axis(first[None], drawn, axis=1)
    return np.where(exists, np.take_along_axis(scores[None], run, axis=1), np.nan)


def mean_interval(scores: Scores) -> tuple[Scores, Scores, Scores]:
    """The mean of each piece over its runs, and both ends of its interval; each (pieces,).

    Student's t interval, `mean -+ t s / sqrt(n)` with n - 1 degrees of freedom, because a bootstrap
    of few runs is too narrow. The ends are NaN for a piece with a single run or equal runs; all are
    NaN for a piece without runs.
    """
    count = np.sum(~np.isnan(scores), axis=0)
    middle = np.nansum(scores, axis=0) / np.where(count, count, np.nan)
    squares = np.nansum((scores - middle) ** 2, axis=0)
    several = np.where(_differ(scores), count, np.nan)
    error = np.sqrt(squares / (several - 1) / several)
    reach = stats.t.ppf((1 + CONFIDENCE) / 2, several - 1) * error
    return middle, middle - reach, middle + reach
