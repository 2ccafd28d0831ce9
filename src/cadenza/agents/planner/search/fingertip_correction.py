"""How servos have to move for fingertips to go where they should."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.hand_goals import ASTRAY, HandGoals
from cadenza.keyboards.keyboard import Keyboard
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


_DEEPER = 0.006  # [m] that a fingertip should be whose key should sound and does not
_THERE = 0.006  # [m] beside where it should be, it is not too high but astray
_HIGHER = 0.01  # [m] that a fingertip should be whose key should not sound and does
_OVER = 0.015  # [m] from the middle of that key, it is not this fingertip that presses it


def mending(
    part: HandGoals,
    steps: NDArray[np.intp],
    keyboard: Keyboard,
    keys: slice,
    tips: Array,
    sounding: NDArray[np.bool_],
) -> tuple[Array, Array]:
    """(S, F, 3) ways to where fingertips should have been [m], and (S, F) how much they count.

    That is where the plan has them; deeper, if that was not deep enough; higher, if they came down
    on a key that should not sound.

    Args:
        part: of the hand.
        steps: (S,) that were played.
        keyboard: all of it.
        keys: those that are looked at, K of them.
        tips: (S, F, 3) where fingertips were after each step [m].
        sounding: (S, K) keys then.
    """
    off = no_further(part.fingertips[steps + 1] - tips)
    weight = part.weight[steps + 1] / ASTRAY
    silent = part.mine[steps, keys] & part.planned[steps, keys] & ~sounding
    step, key = np.nonzero(silent)
    finger = part.asked[steps, keys][step, key]
    there = np.hypot(*off[step, finger, :2].T) < _THERE
    off[step[there], finger[there], 2] -= _DEEPER
    step, key = np.nonzero(part.wrong[steps, keys] & sounding)
    centre, half_size = keyboard.centre[keys], keyboard.half_size[keys]
    beside = np.abs(tips[step, :, :2] - centre[key, None, :2])
    beside[..., 0] = np.maximum(beside[..., 0] - half_size[key, None, 0], 0.0)
    away = beside.sum(axis=2)
    finger, over = away.argmin(axis=1), away.min(axis=1) < _OVER
    high = np.zeros(weight.shape, bool)
    for then in (step, np.maximum(step - 1, 0)):  # it comes too low before
        high[then[over], finger[over]] = True
    off[high, 2] += _HIGHER
    weight[high] = 1.0
    return no_further(off), weight
