"""Pairs of fingers and the keys that they should press."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.tasks.reward import keys_by_transport, press_offset
from cadenza.tasks.view import TaskSpec

Ids = NDArray[np.intp]


class Pairs(NamedTuple):
    """P fingers, each with a key to press."""

    row: Ids
    """(P,) of 0..N-1, to which the pair belongs."""
    finger: Ids
    """(P,)"""
    key: Ids
    """(P,)"""
    offset: Array
    """(P, 3) from where the finger should press its key to the fingertip [m]."""
    share: Array
    """(P,) 1 over the number of pairs in its row, which makes a sum the mean over the fingers."""


def pairs_of(
    task: TaskSpec,
    fingertips: Array,
    key_xpos: Array,
    keys: NDArray[np.bool_],
    fingers: NDArray[np.int8],
) -> Pairs:
    """The pairs that the score gives or, as the task is configured, optimal transport.

    Args:
        task: with hands.
        fingertips: (N, F, 3) [m].
        key_xpos: (N, K, 3) centres of the keys' boxes [m].
        keys: (N, K) to press.
        fingers: (N, K) by the score, -1 for none.
    """
    press, there = press_offset(task.scene.keyboard.half_size), task.scene.present_fingers
    if task.config.fingering == "transport":
        key_of_finger = keys_by_transport(fingertips, key_xpos, press, keys, there)
        row, finger = (key_of_finger >= 0).nonzero()
        key = key_of_finger[row, finger]
    else:
        row, key = (fingers >= 0).nonzero()
        finger = fingers[row, key].astype(np.intp)
    offset = fingertips[row, finger] - key_xpos[row, key] - press[key]
    return Pairs(row, finger, key, offset, 1.0 / np.bincount(row)[row])


def flattened(values: Array) -> Array:
    """(N, K, ...) as (N * K, ...)."""
    return values.reshape(-1, *values.shape[2:])
