"""How to go on from plans that were tried and what they cost: one family, three members.

Each takes N candidates and their costs, and says where to look next: around which plan, and how
far around it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.config import SamplingMethod

Array = NDArray[np.float64]


class Around(NamedTuple):
    """A plan (H, A) and the standard deviation of candidates around it, (H, A)."""

    mean: Array
    sigma: Array


Update = Callable[[Array, Array, Around], Around]

_ELITES = 0.25  # of the candidates
_LEAST_SIGMA = 0.2  # of what it was, so that the search goes on
_TEMPERATURE = 0.1  # of the spread of the costs


def cheapest(candidates: Array, cost: Array, around: Around) -> Around:
    """Predictive sampling (Howell et al., 2022): on from the best, as widely as before.

    Where all cost infinitely, as those do that are no better than what is known, nothing changes.
    """
    best = int(np.argmin(cost))
    return Around(candidates[best], around.sigma) if np.isfinite(cost[best]) else around


def elites(candidates: Array, cost: Array, around: Around) -> Around:
    """Cross-entropy method (Rubinstein, 1999): mean and spread of the best quarter."""
    if not np.isfinite(cost).any():
        return around
    count = max(2, round(_ELITES * len(candidates)))
    best = candidates[np.argsort(cost, kind="stable")[:count]]
    return Around(best.mean(axis=0), np.maximum(best.std(axis=0), _LEAST_SIGMA * around.sigma))


def weighted(candidates: Array, cost: Array, around: Around) -> Around:
    """MPPI (Williams et al., 2017): the mean, weighted by exp(-cost / temperature)."""
    finite = np.isfinite(cost)
    if not finite.any():
        return around
    above = np.where(finite, cost - cost.min(), np.inf)
    temperature = _TEMPERATURE * above[finite].std() + 1e-9
    weight = np.exp(-above / temperature)
    return Around(np.einsum("n,nha->ha", weight / weight.sum(), candidates), around.sigma)


UPDATES: dict[SamplingMethod, Update] = {
    "predictive-sampling": cheapest,
    "cross-entropy": elites,
    "mppi": weighted,
}
