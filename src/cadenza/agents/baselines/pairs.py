"""Which finger is to press which key, one pair after the other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array
from cadenza.tasks.optimal_transport import keys_by_transport_on_host
from cadenza.tasks.reward import press_offset
from cadenza.tasks.view import TaskSpec

Ids = NDArray[np.intp]


class Pairs(NamedTuple):
    """P fingers, each with a key to press."""

    row: Ids
    """(P,) of 0..N-1, that the pair belongs to."""
    finger: Ids
    """(P,)"""
    key: Ids
    """(P,)"""
    offset: Array
    """(P, 3) from where on its key the finger is wanted to where it is [m]."""
    share: Array
    """(P,) 1 over the number of pairs in its row, which makes a sum the mean over the fingers."""


def pairs_of(
    task: TaskSpec,
    fingertips: Array,
    key_xpos: Array,
    keys: NDArray[np.bool_],
    fingers: NDArray[np.int8],
) -> Pairs:
    """By the score or, as the task is configured, by the least way.

    Args:
        task: with hands.
        fingertips: (N, F, 3) [m].
        key_xpos: (N, K, 3) centres of the keys' boxes [m].
        keys: (N, K) to press.
        fingers: (N, K) that the score gives them, -1 for none.
    """
    press, there = press_offset(task.scene.keyboard.half_size), task.scene.fingers_there
    if task.config.fingering == "transport":
        of_fingers = keys_by_transport_on_host(fingertips, key_xpos, press, keys, there)
        row, finger = (of_fingers >= 0).nonzero()
        key = of_fingers[row, finger]
    else:
        row, key = (fingers >= 0).nonzero()
        finger = fingers[row, key].astype(np.intp)
    offset = fingertips[row, finger] - key_xpos[row, key] - press[key]
    return Pairs(row, finger, key, offset, 1.0 / np.bincount(row)[row])
