"""Means, profiles and confidence intervals over the runs and pieces of agents.

After Agarwal, Schwarzer, Castro, Courville, Bellemare: Deep Reinforcement Learning at the Edge of
the Statistical Precipice, NeurIPS 2021, cited by section. Their library, rliable, brings a plotting
stack with it and takes no piece with fewer runs than the others.

Scores are arrays `(..., runs, pieces)`, NaN where a piece has fewer runs than others. Axes before
these, as of resampled scores, all have the same NaN.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Scores = NDArray[np.float64]
Statistic = Callable[[Scores], Scores]

CONFIDENCE = 0.95
RESAMPLES = 2000


def mean(scores: Scores) -> Scores:
    """Returns the mean over pieces (...) of the mean over the runs of each."""
    return np.nanmean(scores, axis=-2).mean(axis=-1)


def interquartile_mean(scores: Scores) -> Scores:
    """Returns the mean (...) of the middle half of all runs of all pieces (section 4.3).

    A quarter of the runs, rounded down, is left out at either end. A few pieces that nobody or
    everybody plays change it less than the mean, and it is surer than the median.
    """
    flat = scores.reshape(*scores.shape[:-2], -1)
    there = ~np.isnan(flat).reshape(-1, flat.shape[-1])[0]
    return np.asarray(stats.trim_mean(flat[..., there], 0.25, axis=-1))


def performance_profile(scores: Scores, thresholds: ArrayLike) -> Scores:
    """Returns the share of runs that is better than each threshold (..., thresholds).

    The "score distribution" of section 4.2: for M pieces of N runs each,
    `F(t) = 1/M sum_m 1/N sum_n [x_nm > t]`.
    """
    thresholds = np.asarray(thresholds, float)
    there = ~np.isnan(scores)
    weights = there / there.sum(axis=-2, keepdims=True) / scores.shape[-1]
    batch = scores.reshape(-1, *scores.shape[-2:])
    # A run's bin is how many thresholds lie below it; every batch has bins of its own.
    bins = len(thresholds) + 1
    below = np.searchsorted(thresholds, batch) + bins * np.arange(len(batch))[:, None, None]
    shares = np.bincount(below.ravel(), weights.ravel(), bins * len(batch)).reshape(-1, bins)
    better = shares[:, ::-1].cumsum(axis=1)[:, -2::-1]
    return better.reshape(*scores.shape[:-2], -1)


def bootstrap_interval(
    statistic: Statistic, scores: Scores, rng: np.random.Generator, resamples: int = RESAMPLES
) -> tuple[Scores, Scores]:
    """Returns both ends of the interval of `statistic` of `scores` (runs, pieces).

    It is the stratified percentile bootstrap of section 4.1: the runs of each piece are drawn anew
    from these runs, with replacement, as many as there are. It tells how much the statistic owes
    to the seeds, for these very pieces. NaN where no piece has two runs that differ: nothing is
    random then.
    """
    if not _differ(scores).any():
        unknown = np.full_like(statistic(scores), np.nan)
        return unknown, unknown
    of_each = statistic(_resampled(scores, rng, resamples))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(of_each, [tail, 1 - tail], axis=0)
    return low, high


def _differ(scores: Scores) -> NDArray[np.bool_]:
    """Returns whether some run of a piece differs from another (pieces,)."""
    least = np.fmin.reduce(scores, axis=0, initial=np.inf)
    return np.asarray(np.fmax.reduce(scores, axis=0, initial=-np.inf) > least)


def _resampled(scores: Scores, rng: np.random.Generator, resamples: int) -> Scores:
    """Draws scores anew (resamples, runs, pieces)."""
    there = ~np.isnan(scores)
    first = np.argsort(~there, axis=0, kind="stable")  # the runs that there are
    drawn = rng.integers(np.maximum(there.sum(axis=0), 1), size=(resamples, *scores.shape))
    run = np.take_along_axis(first[None], drawn, axis=1)
    return np.where(there, np.take_along_axis(scores[None], run, axis=1), np.nan)


def mean_interval(scores: Scores) -> tuple[Scores, Scores, Scores]:
    """Returns the mean of each piece over its runs, and both ends of its interval; each (pieces,).

    Student's t interval, `mean -+ t s / sqrt(n)` with n - 1 degrees of freedom, because a bootstrap
    of few runs is too narrow. NaN from and to for a piece with a single run, or whose runs are all
    the same; all NaN for one with none.
    """
    count = np.sum(~np.isnan(scores), axis=0)
    middle = np.nansum(scores, axis=0) / np.where(count, count, np.nan)
    squares = np.nansum((scores - middle) ** 2, axis=0)
    several = np.where(_differ(scores), count, np.nan)
    error = np.sqrt(squares / (several - 1) / several)
    reach = stats.t.ppf((1 + CONFIDENCE) / 2, several - 1) * error
    return middle, middle - reach, middle + reach
