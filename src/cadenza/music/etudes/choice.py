"""The cheapest of all sequences: how lines and chords are led, with costs in whole numbers.

Whole numbers, so that the same is chosen on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Costs = NDArray[np.int64]
FORBIDDEN = 1_000_000
"""What is against a rule costs this much."""


def cheapest(costs: Sequence[Costs], steps: Sequence[Costs]) -> list[int]:
    """One candidate of each moment, so that the sum is least.

    Args:
        costs: (n_i,) of the candidates of each moment.
        steps: (n_i, n_i+1) of going from a candidate to one of the next moment.
    """
    total, before = costs[0], []
    for cost, step in zip(costs[1:], steps, strict=True):
        ways = total[:, None] + step
        before.append(ways.argmin(axis=0))
        total = ways.min(axis=0) + cost
    chosen = [int(total.argmin())]
    for came_from in reversed(before):
        chosen.append(int(came_from[chosen[-1]]))
    return chosen[::-1]


def fancy(rng: np.random.Generator, count: int, most: int) -> Costs:
    """(count,) up to `most`, drawn: why one etude is not like another."""
    return rng.integers(0, most, count, endpoint=True)
