"""What the hands reach, on this keyboard.

Tables printed by tools/measure_reach.py: the right hand's fingers, thumb to little, on white keys
[m]. The left hand mirrors it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

REST = np.array([-0.0521, -0.0193, 0.0029, 0.0251, 0.0473])
"""(5,) where the fingertips are when all five press, to the right of the forearm."""
MOST = np.array(
    [
        [0.000, 0.085, 0.115, 0.147, 0.182],
        [0.000, 0.000, 0.082, 0.109, 0.127],
        [0.000, 0.000, 0.000, 0.085, 0.104],
        [0.000, 0.000, 0.000, 0.000, 0.085],
        [0.000, 0.000, 0.000, 0.000, 0.000],
    ]
)
"""(5, 5) the greatest distances of two fingers that press, the first nearer the thumb."""
LEAST = 0.0115 * np.maximum(np.arange(5) - np.arange(5)[:, None], 0)
"""(5, 5) the least: fingers side by side on neighbouring keys, which all pairs can reach."""

OUTWARD = np.array([0.092, 0.084, 0.060, 0.037, 0.018])
"""(5,) how far to the right of a fingertip that presses the forearm can be."""

HOME = 0.15  # [m] from the keyboard's middle, where the forearms are mounted
# Where a hand without notes can be [m]: there is always room for it beyond the other.
STANDS = tuple(np.linspace(-0.75, 0.75, 32).tolist())


def is_within(distance: Array, least: Array, most: Array) -> NDArray[np.bool_]:
    """Whether two fingers of a hand can press keys at this `distance` [m] of each other."""
    return (distance >= least) & (distance <= most)


def forearms_touch(right: Array, left: Array) -> NDArray[np.bool_]:
    """Whether the forearms touch if they are as far apart as they can be.

    Args:
        right: where the right one is then [m], to the player's right.
        left: the left one, to the player's left.
    """
    return right + left < 0.149  # twice their radius
