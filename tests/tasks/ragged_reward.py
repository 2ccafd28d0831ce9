"""The reward over lists of the keys and fingers that count: the oracle of the dense terms."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.intp]


def tolerance(x: Array, bound: float, margin: float) -> Array:
    distance = np.maximum(np.maximum(x - bound, -x), 0.0)
    return np.exp(distance * distance * (np.log(0.1) / margin**2))


def key_press(state: Array, activation: Mask, goal: Mask) -> Array:
    env, key = goal.nonzero()
    down = tolerance(1.0 - state[env, key], 0.05, 0.5)
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
    finger: Ids
    key: Ids


def score_pairs(fingers: NDArray[np.int8]) -> Pairs:
    row, key = (fingers >= 0).nonzero()
    return Pairs(row, fingers[row, key].astype(np.intp), key)


def transport_pairs(
    fingertips: Array, key_xpos: Array, press: Array, goal: Mask, there: slice
) -> Pairs:
    pairs = [np.zeros((3, 0), np.intp)]
    for row in np.flatnonzero(goal.any(axis=1)):
        key = np.flatnonzero(goal[row])
        points = key_xpos[row, key] + press[key]
        offsets = fingertips[row, there][:, None] - points
        finger, of_key = linear_sum_assignment(np.linalg.norm(offsets, axis=-1))
        pairs.append(np.array([np.full(len(of_key), row), there.start + finger, key[of_key]]))
    return Pairs(*np.concatenate(pairs, axis=1))


def nearness(
    fingertips: Array, key_xpos: Array, press: Array, pairs: Pairs, otherwise: float
) -> Array:
    row, finger, key = pairs
    offset = fingertips[row, finger] - key_xpos[row, key] - press[key]
    near = tolerance(np.sqrt(np.vecdot(offset, offset)), 0.01, 0.1)
    return _mean_by_row(row, near, len(fingertips), otherwise)
