"""The action of a piano: from the speeds of keys to those of hammers, and to MIDI velocities."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

VELOCITIES = 1, 127  # minimum and maximum of MIDI


@dataclass(frozen=True)
class PianoAction:
    """The action between the keys and the strings of a piano.

    The MIDI velocity of a note is `velocity_at_1 + per_doubling * log2(v)`, where v is the speed of
    its hammer [m/s]: Goebl, "Melody lead in piano performance: expressive device or artifact?"
    (JASA 110(1), 2001), who measured a computer-controlled grand piano.
    """

    # Speed of a hammer over that of the player's end of its key: a hammer travels about 48 mm while
    # the key goes down by about 10 mm (Fletcher and Rossing, The Physics of Musical Instruments,
    # chapter 12)
    hammer_ratio: float = 5.0
    velocity_at_1: float = 52.0  # MIDI velocity of a hammer of 1 m/s
    per_doubling: float = 25.0  # MIDI velocity that doubling the speed adds

    def velocity(self, key_speed: NDArray[np.float64]) -> NDArray[np.float64]:
        """The MIDI velocities, not rounded, of keys whose ends move at these speeds (...) [m/s].

        The arrays are NumPy's or those of a library like it, which can compile this.
        """
        xp = key_speed.__array_namespace__()
        min_speed = 2.0 ** ((VELOCITIES[0] - self.velocity_at_1) / self.per_doubling)
        hammer = xp.maximum(self.hammer_ratio * key_speed, min_speed)
        velocity: NDArray[np.float64] = xp.minimum(
            self.velocity_at_1 + self.per_doubling * xp.log2(hammer), float(VELOCITIES[1])
        )
        return velocity

    def key_speed(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """The speeds of the ends of keys [m/s] that sound with these MIDI velocities."""
        doublings = (np.asarray(velocity, np.float64) - self.velocity_at_1) / self.per_doubling
        return np.asarray(2.0**doublings / self.hammer_ratio)
