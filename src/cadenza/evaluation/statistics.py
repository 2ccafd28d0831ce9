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
MIN_PIECES = 2  # pieces of an interval, at least
_SEED = 0  # seed of the bootstrap: the same runs have the same intervals


def mean(scores: Scores) -> Scores:
    """The mean over pieces (...) of the mean over the runs of each.

    Resampled scores (..., runs, pieces) all have the same NaN.
    """
    return np.nanmean(scores, axis=-2).mean(axis=-1)


def bootstrap_interval(scores: Scores, others: Scores | None = None) -> tuple[float, float]:
    """Both ends of the interval of the `mean` of scores (runs, pieces), or of its difference.

    It is the stratified percentile bootstrap of section 4.1, over pieces, too: pieces are resampled
    with replacement, then the runs of each, as many as there are. So it shows the variation with
    the pieces and with the seeds. The difference is that from the mean of `others`, the scores of
    another agent on the same pieces: both have the same pieces in each sample (paired). NaN for
    less than two pieces.
    """
    num_pieces = scores.shape[1]
    if num_pieces < MIN_PIECES:
        return np.nan, np.nan
    rng = np.random.default_rng(_SEED)
    piece = rng.integers(num_pieces, size=(RESAMPLES, num_pieces))
    means = mean(_resampled(scores, piece, rng))
    if others is not None:
        means = means - mean(_resampled(others, piece, rng))
    tail = (1 - CONFIDENCE) / 2
    low, high = np.quantile(means, [tail, 1 - tail])
    return float(low), float(high)


def _resampled(scores: Scores, piece: NDArray[np.intp], rng: np.random.Generator) -> Scores:
    """Draw runs of pieces (RESAMPLES, pieces) with replacement: (RESAMPLES, runs, pieces)."""
    exists = ~np.isnan(scores)
    first = np.argsort(~exists, axis=0, kind="stable")  # existing runs first
    count, piece = exists.sum(axis=0)[piece][:, None], piece[:, None]
    slot = np.arange(len(scores))[:, None]
    run = first[rng.integers(count, size=(len(piece), *scores.shape)), piece]
    return np.where(slot < count, scores[run, piece], np.nan)


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


def _differ(scores: Scores) -> NDArray[np.bool_]:
    """Whether some run of a piece differs from another (pieces,)."""
    lowest = np.fmin.reduce(scores, axis=0, initial=np.inf)
    return np.asarray(np.fmax.reduce(scores, axis=0, initial=-np.inf) > lowest)
