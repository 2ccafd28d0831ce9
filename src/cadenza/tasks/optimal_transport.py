"""Which fingers should press which keys, where a song has no fingering."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ids = NDArray[np.intp]


def keys_by_transport_on_host(
    fingertips: Array, key_xpos: Array, press: Array, goal: NDArray[np.bool_], there: slice
) -> Ids:
    """(N, F) the key of each finger, -1 for none, so that the ways are the least in sum.

    RP1M (Zhao et al., 2024) assigns fingers so. Unlike the reward terms this cannot be compiled:
    SciPy solves one row after the other.

    Args:
        fingertips: (N, F, 3) [m].
        key_xpos: (N, K, 3) centres of the keys' boxes [m].
        press: (K, 3) from there to where fingers are wanted, see `reward.press_offset` [m].
        goal: (N, K) the keys to press.
        there: those of the F fingers that there are.
    """
    from scipy.optimize import linear_sum_assignment  # slow, and most tasks do without

    keys = np.full(fingertips.shape[:2], -1)
    for row in np.flatnonzero(goal.any(axis=1)):
        key = np.flatnonzero(goal[row])
        points = key_xpos[row, key] + press[key]
        offsets = fingertips[row, there][:, None] - points
        finger, of_key = linear_sum_assignment(np.linalg.norm(offsets, axis=-1))
        keys[row, there.start + finger] = key[of_key]
    return keys
