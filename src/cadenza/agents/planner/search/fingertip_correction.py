"""Damped least squares: how servos have to move for fingertips to go where they should."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.scene.servos import Servos

Array = NDArray[np.float64]

MAX_ERROR = 0.03
"""[m] at which fingertip errors are clipped, so that one finger does not outweigh the others."""
_TOLERANCE = 0.001  # [m] of error that costs as much as moving a servo by its noise


def servo_corrections(error: Array, weight: Array, jacobian: Array, servos: Servos) -> Array:
    """(H, A) the changes of servos that reduce the fingertip errors of H steps.

    Each step is solved by itself, by damped least squares (Wampler, Manipulator Inverse Kinematic
    Solutions Based on Vector Formulations and Damped Least-Squares Methods, 1986). A servo with
    more noise is damped less.

    Args:
        error: (H, F, 3) from fingertips to where they should be [m].
        weight: (H, F) of the squared errors.
        jacobian: (H, F, 3, A) derivatives of fingertips by servos.
        servos: of the hand.
    """
    hessian, gradient = normal_equations(
        clipped(error), weight, jacobian * servos.noise, _TOLERANCE
    )
    damped = hessian + np.eye(len(servos.noise))
    return np.asarray(np.linalg.solve(damped, gradient[..., None])[..., 0] * servos.noise)


def normal_equations(
    error: Array, weight: Array, jacobian: Array, tolerance: float
) -> tuple[Array, Array]:
    """J'WJ (H, A, A) and J'We (H, A) of weighted errors (H, F, 3), in units of `tolerance` [m].

    The arguments are those of `servo_corrections`.
    """
    steps = len(error)
    rows = jacobian.reshape(steps, -1, jacobian.shape[-1])
    weighted = rows.transpose(0, 2, 1) * np.repeat(weight, 3, axis=1)[:, None] / tolerance**2
    return weighted @ rows, (weighted @ error.reshape(steps, -1, 1))[..., 0]


def clipped(error: Array) -> Array:
    """Errors (H, F, 3) [m], shortened to `MAX_ERROR` where they are longer."""
    length = np.linalg.norm(error, axis=2, keepdims=True)
    return error * (MAX_ERROR / np.maximum(length, MAX_ERROR))
