"""The reward terms, pure functions of state and goal, over the batch.

They take arrays of NumPy or of a library like it, whose namespace is `xp`, and all shapes follow
from those of the arguments, so that `jax.jit` can compile them. -1, for none, picks any value,
which a mask then leaves out.

The formulas are those of the paper (Zakka et al., RoboPianist, CoRL 2023, table "reward") as its
published code computes them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.integer]

_LOG_VALUE_AT_MARGIN = math.log(0.1)
_KEY_BOUND, _KEY_MARGIN = 0.05, 0.5
_FINGER_BOUND = 0.01  # [m]
_PRESS_AT = np.array((0.35, 0.0, 0.5))  # of half a key's size, from the centre of its box


class Outcome(NamedTuple):
    """What came of a control step in N environments, and what was wanted of it."""

    state: State
    """The simulations after the step."""
    key_state: Array
    """(N, K) how far the keys are down, 0..1."""
    sounding: Mask
    """(N, K) which keys sound."""
    pedal_down: Mask
    """(N,)"""
    goal_keys: Mask
    """(N, K) which keys should sound."""
    goal_sustain: Mask
    """(N,) whether the pedal should be down."""
    fingers: NDArray[np.int8]
    """(N, K) which fingers should press the keys, -1 for none."""
    ctrl: Array
    """(N, A) the action in actuator units, the pedal last."""

    def __repr__(self) -> str:
        return f"Outcome({len(self.ctrl)} environments)"


RewardTerm = Callable[[Outcome], Array]
"""A term of the reward, (N,)."""


def press_offset(key_half_size: Array) -> Array:
    """(K, 3) where on a key a finger is wanted, from the centre of its box (K, 3) [m]."""
    return _PRESS_AT * key_half_size


def key_state(key_qpos: Array, travel: Array) -> Array:
    """`(..., K)` how far the keys are down, 0..1.

    Args:
        key_qpos: (..., K) angles of the keys [rad].
        travel: (K,) from rest to stop [rad].
    """
    xp = key_qpos.__array_namespace__()
    return xp.minimum(xp.maximum(key_qpos / travel, 0.0), 1.0)


def key_activation(key_qpos: Array, sounds_from: Array) -> Mask:
    """(..., K) which keys sound: those at an angle (K,), near their stop, or beyond it [rad]."""
    return key_qpos >= sounds_from


def key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    """Half for goal keys that are down, half for no other key sounding; arrays (N, K) to (N,)."""
    xp = state.__array_namespace__()
    down = _tolerance(xp, 1.0 - state - _KEY_BOUND, _KEY_MARGIN)
    wrong = (activation > goal).any(-1)
    return 0.5 * (_masked_mean(xp, down, goal) + ~wrong)


def graded_key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    """The same, where every touch of a goal key counts and a wrong key is not as bad as silence.

    A goal key is worth half of how far it is down, and as much again once it sounds. Of the half
    for no other key, what is lost is the share of wrong keys among goal keys and wrong ones.
    """
    xp = state.__array_namespace__()
    wrong = (activation > goal).sum(-1)
    share = wrong / xp.maximum(goal.sum(-1) + wrong, 1)
    return 0.5 * (_masked_mean(xp, 0.5 * (state + activation), goal) + 1.0 - share)


def score_fingering(
    fingertips: Array,
    key_xpos: Array,
    press: Array,
    fingers: Ids,
    margin: float = TaskConfig.fingering_margin,
) -> Array:
    """(N,) mean nearness of fingers to the keys that the score gives them, 0 where it gives none.

    Args:
        fingertips: (N, F, 3) [m].
        key_xpos: (N, K, 3) centres of the keys' boxes [m].
        press: (K, 3) from there to where fingers are wanted, see `press_offset` [m].
        fingers: (N, K) for the keys, of 0..F-1, -1 for none.
        margin: over which nearness falls to a tenth, from 1 cm on [m].
    """
    xp = fingertips.__array_namespace__()
    rows = xp.arange(len(fingers))[:, None]
    offset = fingertips[rows, fingers] - key_xpos - press
    return _masked_mean(xp, _nearness(xp, offset, margin), fingers >= 0)


def transport_fingering(
    fingertips: Array,
    key_xpos: Array,
    press: Array,
    keys: Ids,
    margin: float = TaskConfig.fingering_margin,
) -> Array:
    """(N,) mean nearness of fingers to the keys assigned to them, 1 where none is (RP1M).

    Args:
        fingertips: (N, F, 3) [m].
        key_xpos: (N, K, 3) centres of the keys' boxes [m].
        press: (K, 3) from there to where fingers are wanted, see `press_offset` [m].
        keys: (N, F) for the fingers, -1 for none, see `optimal_transport`.
        margin: over which nearness falls to a tenth, from 1 cm on [m].
    """
    xp = fingertips.__array_namespace__()
    rows = xp.arange(len(keys))[:, None]
    offset = fingertips - key_xpos[rows, keys] - press[keys]
    assigned = keys >= 0
    mean = _masked_mean(xp, _nearness(xp, offset, margin), assigned)
    return xp.where(assigned.any(-1), mean, 1.0)


def energy(force: Array, velocity: Array, coefficient: float) -> Array:
    """Minus the power of all actuators times `coefficient`; arrays (N, A) [N, N m] and speeds."""
    xp = force.__array_namespace__()
    return -coefficient * xp.vecdot(abs(force), abs(velocity))


def sustain(pedal_down: Mask, goal: Mask) -> Array:
    """Pedal as the score wants it; arrays (N,)."""
    xp = goal.__array_namespace__()
    difference = goal.astype(float) - pedal_down.astype(float)
    beyond = xp.maximum(difference - _KEY_BOUND, -difference)
    return _tolerance(xp, beyond, _KEY_MARGIN)


def forearm(contact: Mask) -> Array:
    """A half unless the forearms touch; arrays (N,)."""
    return contact.__array_namespace__().where(contact, 0.0, 0.5)


def _tolerance(xp: Any, beyond: Array, margin: float) -> Array:
    """1 up to the bound, falling off as a Gaussian to 0.1 at `margin` beyond it."""
    distance = xp.maximum(beyond, 0.0)
    return xp.exp(distance * distance * (_LOG_VALUE_AT_MARGIN / margin**2))


def _nearness(xp: Any, offset: Array, margin: float) -> Array:
    """(N, P) of fingers that are (N, P, 3) away from where they are wanted [m]."""
    distance = xp.sqrt(xp.vecdot(offset, offset))
    return _tolerance(xp, distance - _FINGER_BOUND, margin)


def _masked_mean(xp: Any, values: Array, mask: Mask) -> Array:
    """(N,) means of the values (N, P) in the mask (N, P), 0 where there are none.

    They are added up one after the other, which zeros in between do not change. A plain sum adds
    in an order that depends on N and P, and so rounds otherwise.
    """
    total = xp.where(mask, values, 0.0).cumsum(-1)[:, -1]
    return total / xp.maximum(mask.sum(-1), 1)
