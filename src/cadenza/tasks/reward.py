"""The reward terms, pure functions of state and goal, over the batch.

The formulas are those of the paper (Zakka et al., RoboPianist, CoRL 2023, table "reward") as its
published code computes them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cadenza.model.piano import KEY_HALF_SIZE, KEY_TRAVEL, SOUND_TOLERANCE

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LOG_VALUE_AT_MARGIN = np.log(0.1)
_KEY_BOUND, _KEY_MARGIN = 0.05, 0.5
_FINGER_BOUND, _FINGER_MARGIN = 0.01, 0.1  # [m]
_SOUNDS_FROM = KEY_TRAVEL - SOUND_TOLERANCE  # [rad]
PRESS_OFFSET = np.stack(
    [0.35 * KEY_HALF_SIZE[:, 0], np.zeros(len(KEY_HALF_SIZE)), 0.5 * KEY_HALF_SIZE[:, 2]], axis=1
)
"""(88, 3) where on a key a finger is wanted, from the centre of its box [m]."""


def tolerance(x: Array, bound: float, margin: float) -> Array:
    """1 for 0 <= x <= bound, falling off as a Gaussian to 0.1 at `margin` beyond either side."""
    distance = np.maximum(np.maximum(x - bound, -x), 0.0)
    return np.exp(distance * distance * (_LOG_VALUE_AT_MARGIN / margin**2))


def key_state(key_qpos: Array) -> Array:
    """How far the keys are down, 0..1, of the same shape `(..., 88)` as their angles [rad]."""
    return np.minimum(np.maximum(key_qpos / KEY_TRAVEL, 0.0), 1.0)


def key_activation(key_qpos: Array) -> Mask:
    """Which keys sound, `(..., 88)`: those within half a degree of their stop."""
    return key_qpos >= _SOUNDS_FROM


def key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    """Half for goal keys that are down, half for no other key sounding; arrays (N, 88) to (N,)."""
    env, key = goal.nonzero()
    down = tolerance(1.0 - state[env, key], _KEY_BOUND, _KEY_MARGIN)
    wrong = (activation > goal).any(axis=1)
    return 0.5 * (_mean_by_row(env, down, len(goal), otherwise=0.0) + ~wrong)


def _mean_by_row(
    row: NDArray[np.intp], values: Array, num_rows: int, otherwise: float
) -> NDArray[np.float64]:
    """(num_rows,) means of the values (P,) that belong to each row, `otherwise` where none does."""
    count = np.bincount(row, minlength=num_rows)
    total = np.bincount(row, values, num_rows)
    return np.where(count, total / np.maximum(count, 1), otherwise)


def finger_distances(
    fingertips: Array, key_xpos: Array, fingers: NDArray[np.int8]
) -> tuple[NDArray[np.intp], Array]:
    """How far fingers are from the keys they should press.

    Args:
        fingertips: (N, 10, 3) [m].
        key_xpos: (N, 88, 3) centres of the keys' boxes [m].
        fingers: (N, 88) the finger that each key wants, -1 for none.

    Returns:
        For each of P pairs of finger and key the row 0..N-1 that it belongs to (P,), and its
        distance (P,) [m].
    """
    env, key = (fingers >= 0).nonzero()
    offset = fingertips[env, fingers[env, key]] - key_xpos[env, key] - PRESS_OFFSET[key]
    return env, np.sqrt(np.vecdot(offset, offset))


def transport_distances(
    fingertips: Array, key_xpos: Array, goal: Mask
) -> tuple[NDArray[np.intp], Array]:
    """As `finger_distances`, with the fingers that get to the keys by the least way in sum.

    RP1M (Zhao et al., 2024) assigns fingers so where a song has no fingering. `goal` (N, 88) are
    the keys to press, `fingertips` (N, F, 3) the fingertips that there are.
    """
    envs, distances = [np.zeros(0, np.intp)], [np.zeros(0)]
    for env in np.flatnonzero(goal.any(axis=1)):
        key = np.flatnonzero(goal[env])
        offsets = fingertips[env][:, None] - key_xpos[env, key] - PRESS_OFFSET[key]
        distance = np.sqrt((offsets**2).sum(axis=-1))
        assigned = distance[linear_sum_assignment(distance)]
        envs.append(np.full(len(assigned), env))
        distances.append(assigned)
    return np.concatenate(envs), np.concatenate(distances, dtype=np.float64)


def nearness(env: NDArray[np.intp], distance: Array, num_envs: int, otherwise: float) -> Array:
    """(N,) mean nearness of fingers to their keys, from pairs as `finger_distances` gives them.

    `otherwise` is what a row without pairs gets: 0 with the score's fingering (the published
    code), 1 with optimal transport (RP1M).
    """
    near = tolerance(distance, _FINGER_BOUND, _FINGER_MARGIN)
    return _mean_by_row(env, near, num_envs, otherwise)


def energy(force: Array, velocity: Array, coefficient: float) -> Array:
    """Minus the power of all actuators times `coefficient`; arrays (N, A) [N, N m] and speeds."""
    return -coefficient * np.vecdot(np.abs(force), np.abs(velocity))


def sustain(pedal_down: Mask, goal: Mask) -> Array:
    """Pedal as the score wants it; arrays (N,)."""
    difference = goal.astype(float) - pedal_down.astype(float)
    return tolerance(difference, _KEY_BOUND, _KEY_MARGIN)


def forearm(contact: Mask) -> Array:
    """A half unless the forearms touch; arrays (N,)."""
    return np.where(contact, 0.0, 0.5)
