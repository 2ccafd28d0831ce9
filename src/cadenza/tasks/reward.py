"""The reward terms, pure functions of state and goal, over the batch.

The formulas are those of the paper (Zakka et al., RoboPianist, CoRL 2023, table "reward") as its
published code computes them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cadenza.keyboards.piano import PIANO
from cadenza.sim.protocol import State

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.intp]

_LOG_VALUE_AT_MARGIN = np.log(0.1)
_KEY_BOUND, _KEY_MARGIN = 0.05, 0.5
_FINGER_BOUND, _FINGER_MARGIN = 0.01, 0.1  # [m]
PRESS_OFFSET = np.stack(
    [0.35 * PIANO.half_size[:, 0], np.zeros(PIANO.num_keys), 0.5 * PIANO.half_size[:, 2]], axis=1
)
"""(88, 3) where on a key a finger is wanted, from the centre of its box [m]."""


class Outcome(NamedTuple):
    """What came of a control step in N environments, and what was wanted of it."""

    state: State
    """The simulations after the step."""
    key_state: Array
    """(N, 88) how far the keys are down, 0..1."""
    sounding: Mask
    """(N, 88) which keys sound."""
    pedal_down: Mask
    """(N,)"""
    goal_keys: Mask
    """(N, 88) which keys should sound."""
    goal_sustain: Mask
    """(N,) whether the pedal should be down."""
    fingers: NDArray[np.int8]
    """(N, 88) which fingers should press the keys, -1 for none."""
    ctrl: Array
    """(N, A) the action in actuator units, the pedal last."""


RewardTerm = Callable[[Outcome], Array]
"""A term of the reward, (N,)."""


def tolerance(x: Array, bound: float, margin: float) -> Array:
    """1 for 0 <= x <= bound, falling off as a Gaussian to 0.1 at `margin` beyond either side."""
    distance = np.maximum(np.maximum(x - bound, -x), 0.0)
    return np.exp(distance * distance * (_LOG_VALUE_AT_MARGIN / margin**2))


def key_state(key_qpos: Array) -> Array:
    """How far the keys are down, 0..1, of the same shape `(..., 88)` as their angles [rad]."""
    return np.minimum(np.maximum(key_qpos / PIANO.travel, 0.0), 1.0)


def key_activation(key_qpos: Array) -> Mask:
    """Which keys sound, `(..., 88)`: those within half a degree of their stop."""
    return key_qpos >= PIANO.sounds_from


def key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    """Half for goal keys that are down, half for no other key sounding; arrays (N, 88) to (N,)."""
    env, key = goal.nonzero()
    down = tolerance(1.0 - state[env, key], _KEY_BOUND, _KEY_MARGIN)
    wrong = (activation > goal).any(axis=1)
    return 0.5 * (_mean_by_row(env, down, len(goal), otherwise=0.0) + ~wrong)


def _mean_by_row(row: Ids, values: Array, num_rows: int, otherwise: float) -> Array:
    """(num_rows,) means of the values (P,) that belong to each row, `otherwise` where none does."""
    count = np.bincount(row, minlength=num_rows)
    total = np.bincount(row, values, num_rows)
    return np.where(count, total / np.maximum(count, 1), otherwise)


class Pairs(NamedTuple):
    """P fingers, each with a key to press; arrays (P,)."""

    row: Ids
    """Of 0..N-1, that it belongs to."""
    finger: Ids
    key: Ids


def score_pairs(fingers: NDArray[np.int8]) -> Pairs:
    """The fingers (N, 88) that the score gives to keys, -1 for none."""
    row, key = (fingers >= 0).nonzero()
    return Pairs(row, fingers[row, key].astype(np.intp), key)


def transport_pairs(fingertips: Array, key_xpos: Array, goal: Mask, there: Ids) -> Pairs:
    """The fingers that get to the keys by the least way in sum.

    RP1M (Zhao et al., 2024) assigns fingers so where a song has no fingering.

    Args:
        fingertips: (N, 10, 3) [m].
        key_xpos: (N, 88, 3) centres of the keys' boxes [m].
        goal: (N, 88) the keys to press.
        there: (F,) the fingers that there are.
    """
    pairs = [np.zeros((3, 0), np.intp)]
    for row in np.flatnonzero(goal.any(axis=1)):
        key = np.flatnonzero(goal[row])
        points = key_xpos[row, key] + PRESS_OFFSET[key]
        offsets = fingertips[row, there][:, None] - points
        finger, of_key = linear_sum_assignment(np.linalg.norm(offsets, axis=-1))
        pairs.append(np.array([np.full(len(of_key), row), there[finger], key[of_key]]))
    return Pairs(*np.concatenate(pairs, axis=1))


def press_offsets(fingertips: Array, key_xpos: Array, pairs: Pairs) -> Array:
    """(P, 3) from where on its key each finger is wanted to where it is [m].

    Args:
        fingertips: (N, 10, 3) [m].
        key_xpos: (N, 88, 3) centres of the keys' boxes [m].
        pairs: of fingers and keys.
    """
    row, finger, key = pairs
    return fingertips[row, finger] - key_xpos[row, key] - PRESS_OFFSET[key]


def nearness(row: Ids, offset: Array, num_rows: int, otherwise: float) -> Array:
    """(num_rows,) mean nearness of fingers to their keys.

    Args:
        row: (P,) that each finger belongs to.
        offset: (P, 3) of each, as `press_offsets` has it [m].
        num_rows: N.
        otherwise: what a row without fingers gets: 0 with the score's fingering (the published
            code), 1 with optimal transport (RP1M).
    """
    distance = np.sqrt(np.vecdot(offset, offset))
    near = tolerance(distance, _FINGER_BOUND, _FINGER_MARGIN)
    return _mean_by_row(row, near, num_rows, otherwise)


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
