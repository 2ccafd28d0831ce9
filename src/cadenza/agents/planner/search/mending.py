"""Where fingertips should have been, for the keys that were wrong to be right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.hand_goals import ASTRAY, HandGoals
from cadenza.agents.planner.search.fingertip_correction import no_further
from cadenza.keyboards.keyboard import Keyboard

Array = NDArray[np.float64]

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
