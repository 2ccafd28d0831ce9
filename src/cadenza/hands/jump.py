"""How long a hand takes from keys to others, for whoever plans or chooses fingers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JumpTimes:
    """How long before it strikes the next keys a hand has to let go of others.

    Within reach the fingers do it. Further away the hand glides there, as if it sped up over half
    the way and slowed down over the other, lifting itself on the way; on a chord it comes straight
    down.
    """

    within_reach: float = 0.05
    """How far the hand need not move from keys that it leaves as it strikes others [m]."""
    while_holding: float = 0.06
    """How far from keys that it goes on holding [m]."""
    glide: float = 80.0
    """From one key to one [m/s^2]."""
    glide_of_chord: float = 50.0
    """From or to a chord [m/s^2]."""
    descent: float = 0.05
    """On a chord [s]."""
    climb: float = 0.1
    """In which a finger gets off a white key and onto a black one [s]."""

    def hurried(self, haste: float) -> JumpTimes:
        """With so many times the acceleration."""
        return replace(self, glide=haste * self.glide, glide_of_chord=haste * self.glide_of_chord)

    def seconds(
        self, way: ArrayLike, left: ArrayLike, struck: ArrayLike, holding: ArrayLike = False
    ) -> Array:
        """How long before the next keys are struck those before have to be let go [s].

        0 where they need not be. All arguments broadcast.

        Args:
            way: that the hand moves along the keyboard [m].
            left: number of keys that it left together, 1 or more.
            struck: number of keys that it strikes together, 1 or more.
            holding: whether the keys left should be held beyond the moment at which the next are
                struck.
        """
        reach = np.where(holding, self.while_holding, self.within_reach)
        beyond = np.maximum(np.asarray(way) - reach, 0.0)
        single = (np.asarray(left) == 1) & (np.asarray(struck) == 1)
        glide = np.where(single, self.glide, self.glide_of_chord)
        descent = np.where(np.asarray(struck) > 1, self.descent, 0.0)
        return np.where(beyond > 0, np.sqrt(4 * beyond / glide) + descent, 0.0)
