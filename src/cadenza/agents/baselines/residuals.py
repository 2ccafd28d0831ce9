"""Residuals of the paper's cost: of keys from their goals, and of fingers from their keys."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Ids
from cadenza.sim.linearisation import Linearisation
from cadenza.sim.protocol import State
from cadenza.tasks.reward import key_state, keys_by_transport, press_offset
from cadenza.tasks.view import TaskSpec


class Residuals(NamedTuple):
    """Residuals of K keys and of Q fingers with a key to press, in R states."""

    keys: Array  # (R, K) the states of the keys, 1 if down, less their goals
    row: Ids  # (Q,) the state to which each finger's residual belongs
    finger: Ids  # (Q,) the finger
    key: Ids  # (Q,) the key that the finger should press
    offset: Array  # (Q, 3) the fingertip's position less that where it should press the key [m]
    # (Q,) 1 over the number of fingers in the row, which makes a sum the mean over the fingers
    share: Array

    def cost(self, keys: Array, fingers: Array) -> Array:
        """Costs (R,), given norms of the residuals of keys (R,) and of fingers (Q,)."""
        return keys + np.bincount(self.row, self.share * fingers, len(keys))


def residuals_of(
    task: TaskSpec,
    states: State | Linearisation,
    keys: NDArray[np.bool_],
    fingers: NDArray[np.int8],
) -> Residuals:
    """Residuals in all states; the score or the task says which finger presses which key.

    Args:
        task: a task with hands.
        states: R = N P states, with leading dimensions (N, P).
        keys: (R, K) the keys to press.
        fingers: (R, K) the fingers of the score, -1 for none; optimal transport from fingertips to
            keys replaces them if the task is so configured.
    """
    keyboard, tips = task.scene.keyboard, flattened(states.fingertip_xpos)
    centres, press = flattened(states.key_xpos), press_offset(keyboard.half_size)
    if task.config.fingering == "transport":
        present = task.scene.present_fingers
        key_of_finger = keys_by_transport(tips, centres, press, keys, present)
        row, finger = (key_of_finger >= 0).nonzero()
        key = key_of_finger[row, finger]
    else:
        row, key = (fingers >= 0).nonzero()
        finger = fingers[row, key].astype(np.intp)
    offset = tips[row, finger] - centres[row, key] - press[key]
    depth = key_state(flattened(states.key_qpos), keyboard.travel)
    return Residuals(depth - keys, row, finger, key, offset, 1.0 / np.bincount(row)[row])


def flattened(values: Array) -> Array:
    """Reshape (N, P, ...) to (N P, ...)."""
    return values.reshape(-1, *values.shape[2:])
