"""Puts plans of a hand together, finger by finger."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WORTH = 0.15  # that a finger has to cost less
_SEEN = 3  # steps that must have been tried for that


def combined(plans: Array, costs: Sequence[Array], best: int, finger: NDArray[np.intp]) -> Array:
    """(C, H, A) the best plan, with each finger as in the plan in which it does best by itself.

    One plan mends what one finger does, another what another does, and each is worse elsewhere. As
    the hand is where it is, fingers hardly move each other.

    There is none if no finger does much better in another plan.

    Args:
        plans: (N, H, A)
        costs: (L, F) of each, what L of its H steps have cost by finger.
        best: which has been tried to its end, and cost least.
        finger: (A,) that each servo moves, -1 for the whole hand.
    """
    so_far = np.pad(costs[best].cumsum(axis=0), ((1, 0), (0, 0)))
    better = np.array([so_far[len(cost)] - cost.sum(axis=0) for cost in costs])
    better[[len(cost) < min(_SEEN, len(costs[best])) for cost in costs]] = 0.0
    of = np.where(better.max(axis=0) > _WORTH, better.argmax(axis=0), best)
    plan = plans[np.append(of, best)[finger], :, np.arange(len(finger))].T
    return plan[None] if (of != best).any() else plans[:0]
