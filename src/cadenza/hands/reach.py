"""The reach of fingers and the speed of hands, for planners that do not simulate them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reach:
    """The reach of the F fingers of a right hand on white keys, the thumb first.

    All lengths are along the keyboard [m], to the right. A left hand is its mirror image.
    `cadenza hand measure` measures it.
    """

    rest: Array
    """(F,) places of the fingertips when all press, relative to the forearm."""
    least: Array
    """(F, F) least distances of two fingers that press; rows are the finger nearer the thumb."""
    most: Array
    """(F, F) greatest distances."""
    outward: Array
    """(F,) greatest distance of the forearm to the right of a fingertip that presses."""
    inward: Array
    """(F,) greatest distance of the forearm to the left of a fingertip that presses."""
    forearm_width: float
    """Distance below which two forearms touch."""
    effort: Array | float = 0.0
    """(F,) cost of pressing with each finger, 1 for something worth avoiding once."""
    effort_on_black: Array | float = 0.0
    """(F,) additional cost of pressing black keys with each finger."""

    def spans(self, finger: ArrayLike, other: ArrayLike, distance: ArrayLike) -> NDArray[np.bool_]:
        """Whether two fingers, 0 for the thumb, can press two keys at once; arguments broadcast.

        The other key is at this `distance`, outwards: to the right for a right hand [m].
        """
        finger, other, distance = np.asarray(finger), np.asarray(other), np.asarray(distance)
        outer, inner = np.maximum(finger, other), np.minimum(finger, other)
        apart = np.where(finger < other, distance, -distance)
        return (apart >= self.least[inner, outer]) & (apart <= self.most[inner, outer])

    @property
    def num_fingers(self) -> int:
        """F, the number of fingers."""
        return len(self.rest)


@dataclass(frozen=True)
class JumpTimes:
    """A model of the time that a hand takes from some keys to the next.

    Fingers get to keys within reach without the hand. To keys further away it glides: over half the
    way it accelerates, then it decelerates. To strike a chord it then descends.
    """

    # Distance that fingers cover without the hand, from keys that are released [m]
    within_reach: float = 0.035
    # Distance that fingers cover without the hand, from keys that stay held [m]
    while_holding: float = 0.06
    glide: float = 48.0  # acceleration from a single key to a single key [m/s^2]
    glide_of_chord: float = 30.0  # acceleration from or to a chord [m/s^2]
    descent: float = 0.05  # time to come down on a chord [s]
    # Time in which a finger gets from a key to the next one, or up and down on the same one [s]
    next_key: float = 0.1

    def accelerated(self, factor: float) -> JumpTimes:
        """The times of the hand with `factor` times the acceleration."""
        return replace(self, glide=factor * self.glide, glide_of_chord=factor * self.glide_of_chord)

    def seconds(
        self, distance: ArrayLike, left: ArrayLike, struck: ArrayLike, holding: ArrayLike = False
    ) -> Array:
        """The time between the release of keys and the strike of the next [s].

        0 where the fingers get there without the hand. All arguments broadcast. From rest to rest
        over x at acceleration a takes sqrt(4 x / a).

        Args:
            distance: how far the hand moves along the keyboard [m].
            left: number of keys that it leaves together, 1 or more.
            struck: number of keys that it strikes together, 1 or more.
            holding: whether the keys left should be held until after the next are struck.
        """
        reach = np.where(holding, self.while_holding, self.within_reach)
        glided = np.maximum(np.asarray(distance) - reach, 0.0)
        single = (np.asarray(left) == 1) & (np.asarray(struck) == 1)
        acceleration = np.where(single, self.glide, self.glide_of_chord)
        descent = np.where(np.asarray(struck) > 1, self.descent, 0.0)
        return np.where(glided > 0, np.sqrt(4 * glided / acceleration) + descent, 0.0)
