"""Update rules of sampling-based control: predictive sampling, cross-entropy method, MPPI.

Each takes N candidates, their costs, and the distribution that they were drawn from, and returns
the distribution of the next ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.config import SamplingMethod


class SamplingDistribution(NamedTuple):
    """Mean and standard deviation of control sequences, both (H, A)."""

    mean: Array
    sigma: Array


Update = Callable[[Array, Array, SamplingDistribution], SamplingDistribution]

_ELITE_SHARE = 0.25  # of the candidates
_MIN_SIGMA = 0.2  # of the standard deviation before the update: it must not collapse
_TEMPERATURE = 0.1  # of the standard deviation of the costs
_MIN_TEMPERATURE = 1e-9  # where all costs are the same


def predictive_sampling(
    candidates: Array, cost: Array, before: SamplingDistribution
) -> SamplingDistribution:
    """Moves the mean to the cheapest candidate (Howell et al., 2022).

    Nothing changes if all costs are infinite, as they are where no candidate is an improvement.
    """
    best = int(np.argmin(cost))
    return before._replace(mean=candidates[best]) if np.isfinite(cost[best]) else before


def cross_entropy(
    candidates: Array, cost: Array, before: SamplingDistribution
) -> SamplingDistribution:
    """Cross-entropy method (Rubinstein, 1999): mean and standard deviation of the elites."""
    if not np.isfinite(cost).any():
        return before
    count = max(2, round(_ELITE_SHARE * len(candidates)))
    elites = candidates[np.argsort(cost, kind="stable")[:count]]
    sigma = np.maximum(elites.std(axis=0), _MIN_SIGMA * before.sigma)
    return SamplingDistribution(elites.mean(axis=0), sigma)


def mppi(candidates: Array, cost: Array, before: SamplingDistribution) -> SamplingDistribution:
    """MPPI (Williams et al., 2017): the mean weighted by exp(-cost / temperature)."""
    finite = np.isfinite(cost)
    if not finite.any():
        return before
    above = np.where(finite, cost - cost.min(), np.inf)
    temperature = _TEMPERATURE * above[finite].std() + _MIN_TEMPERATURE
    weight = np.exp(-above / temperature)
    return before._replace(mean=np.einsum("n,nha->ha", weight / weight.sum(), candidates))


UPDATES: dict[SamplingMethod, Update] = {
    "predictive-sampling": predictive_sampling,
    "cross-entropy": cross_entropy,
    "mppi": mppi,
}
