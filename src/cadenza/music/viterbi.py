"""The cheapest sequence of candidates, by dynamic programming."""

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray


def cheapest_sequence(costs: Sequence[NDArray[Any]], steps: Sequence[NDArray[Any]]) -> list[int]:
    """The candidates of all moments, one each, whose costs have the least sum (Viterbi).

    `costs` (n_i,) are of the candidates of each moment, `steps` (n_i, n_i+1) of going from one to
    one of the next.
    """
    total, predecessors = costs[0], []
    for cost, step in zip(costs[1:], steps, strict=True):
        sums = total[:, None] + step
        predecessors.append(sums.argmin(axis=0))
        total = sums.min(axis=0) + cost
    chosen = [int(total.argmin())]
    for predecessor in reversed(predecessors):
        chosen.append(int(predecessor[chosen[-1]]))
    return chosen[::-1]
