"""How servos have to move for fingertips to go where they should."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.hand_rollouts import HandRollouts

Array = NDArray[np.float64]

FURTHEST = 0.03  # [m] further away does not count more
_NEAR = 0.001  # [m] to which they are corrected with servos that move as far as noise moves them


class Correction:
    """Turns what a trial of a hand shows of its fingertips into changes of its servos.

    A servo moves by what would take fingertips where they should be, in least squares, by the
    Jacobian of the hand.
    """

    def __init__(self, scene: Scene) -> None:
        """`scene` is with this hand only."""
        servos = servos_of(scene)
        self._joints = servos.joints
        self._sigma = servos.noise

    def of(self, trials: HandRollouts, hand_qpos: Array, off: Array, weight: Array) -> Array:
        """(H, A) how much further servos should be after H steps.

        Args:
            trials: of the hand.
            hand_qpos: (H, J) after each step [m, rad].
            off: (H, F, 3) the ways from fingertips to where they should be then [m].
            weight: (H, F) how much they count.
        """
        off = no_further(off)
        motion = trials.fingertip_motion(hand_qpos) @ self._joints.T
        slope = (motion * self._sigma).reshape(len(off), -1, len(self._sigma))  # of noise
        pull = slope.transpose(0, 2, 1) * np.repeat(weight, 3, axis=1)[:, None] / _NEAR**2
        square = pull @ slope + np.eye(len(self._sigma))
        change = np.linalg.solve(square, pull @ off.reshape(len(off), -1, 1))[..., 0]
        return np.asarray(change * self._sigma)


def no_further(off: Array) -> Array:
    """The ways (H, F, 3) [m], those that are longer than `FURTHEST` as long as that."""
    far = np.linalg.norm(off, axis=2, keepdims=True)
    return off * (FURTHEST / np.maximum(far, FURTHEST))
