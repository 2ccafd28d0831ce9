"""What the fingers of a hand reach, for whoever chooses fingers without simulating them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reach:
    """Of the F fingers of a right hand on white keys, thumb first; `tools/measure_reach.py`.

    All lengths are along the keyboard [m], to the right. A left hand is its mirror image.
    """

    rest: Array
    """(F,) where the fingertips are when all press, from the forearm."""
    least: Array
    """(F, F) least distances of two fingers that press; row the finger nearer the thumb."""
    most: Array
    """(F, F) greatest distances."""
    outward: Array
    """(F,) how far to the right of a fingertip that presses the forearm can be."""
    inward: Array
    """(F,) how far to its left."""
    forearm_width: float
    """Two forearms touch when they are nearer than this."""
    effort: Array | float = 0.0
    """(F,) what it costs to press with a finger, 1 for something worth avoiding once."""
    effort_on_black: Array | float = 0.0
    """(F,) what it costs beyond that on black keys."""

    def spans(self, finger: ArrayLike, other: ArrayLike, distance: ArrayLike) -> NDArray[np.bool_]:
        """Whether two fingers can press two keys at once.

        All arguments broadcast.

        Args:
            finger: that presses one key, 0 for the thumb.
            other: that presses the other key.
            distance: of the other key from the one, outwards: to the right for a right hand [m].
        """
        finger, other, distance = np.asarray(finger), np.asarray(other), np.asarray(distance)
        outer, inner = np.maximum(finger, other), np.minimum(finger, other)
        apart = np.where(finger < other, distance, -distance)
        return (apart >= self.least[inner, outer]) & (apart <= self.most[inner, outer])

    @property
    def num_fingers(self) -> int:
        """F"""
        return len(self.rest)
