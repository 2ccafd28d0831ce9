"""Control-limited differential dynamic programming (box-DDP), for any quadratic model.

Tassa, Mansard, Todorov, "Control-Limited Differential Dynamic Programming", ICRA 2014 (below: the
paper).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TOLERANCE = 1e-9  # norm of the free gradient, relative to the gradient at the start
_MAX_NEWTON_STEPS = 100
_ARMIJO = 0.1  # share of the decrease that the gradient predicts
_BACKTRACKING = 0.6  # factor between step sizes
_MIN_STEP_SIZE = 1e-12  # below which rounding errors decide


class Model(NamedTuple):
    """Quadratic model of K steps, with n states x and m controls u that make up z = (x, u)."""

    transition: Array
    """(K, n, n + m) derivatives of the next state by z."""
    gradient: Array
    """(K, n + m) the gradient of a step's cost by z."""
    hessian: Array
    """(K, n + m, n + m) the Hessian of a step's cost by z."""


class FeedbackLaw(NamedTuple):
    """Changes of the controls, k + K dx, where dx is the deviation from the nominal states."""

    offset: Array
    """(K, m) k of each step."""
    gain: Array
    """(K, m, n) K of each step; its rows are zero for controls at a limit."""


def box_qp(
    hessian: Array, gradient: Array, low: Array, high: Array, start: Array
) -> tuple[Array, Mask]:
    """Minimises x'Hx / 2 + g'x over low <= x <= high by projected Newton steps (the paper, III-B).

    Args:
        hessian: (m, m).
        gradient: (m,).
        low: (m,).
        high: (m,).
        start: (m,) initial guess.

    Returns:
        The solution (m,), and which of its elements are free (m,), not held at a limit.

    Raises:
        np.linalg.LinAlgError: the Hessian is not positive definite in the free directions.
    """
    x = np.clip(start, low, high)
    tolerance = _TOLERANCE * (np.linalg.norm(gradient) + np.linalg.norm(hessian @ x))
    for _ in range(_MAX_NEWTON_STEPS):
        here = gradient + hessian @ x
        free = ~(((x <= low) & (here > 0)) | ((x >= high) & (here < 0)))
        if np.linalg.norm(here[free]) <= tolerance:
            break
        step = np.zeros_like(x)
        step[free] = -_solve(hessian[np.ix_(free, free)], here[free])
        x, before = _line_search(hessian, here, x, step, low, high), x
        if (x == before).all():
            break
    return x, free


def _line_search(
    hessian: Array, gradient: Array, x: Array, step: Array, low: Array, high: Array
) -> Array:
    """The end (m,) of the longest projected step that meets the Armijo condition.

    `gradient` (m,) is that at `x`.
    """
    size = 1.0
    while size > _MIN_STEP_SIZE:
        end = np.clip(x + size * step, low, high)
        change = end - x
        if gradient @ change + change @ hessian @ change / 2 <= _ARMIJO * (gradient @ change):
            return end  # not x + change, which may miss a limit by a rounding
        size *= _BACKTRACKING
    return x


def _solve(matrix: Array, right: Array) -> Array:
    return np.asarray(cho_solve(cho_factor(matrix), right))


def backward_pass(
    model: Model, controls: Array, low: Array, high: Array, regularisation: float
) -> FeedbackLaw:
    """The feedback law that minimises the quadratic model within the limits (the paper, III-C).

    Args:
        model: the model of K steps; there is no terminal cost.
        controls: (K, m) nominal controls.
        low: (m,) limits of the controls.
        high: (m,).
        regularisation: added to the diagonal of the control Hessian (Levenberg-Marquardt).

    Raises:
        np.linalg.LinAlgError: it takes more regularisation.
    """
    steps, m = controls.shape
    n = model.transition.shape[1]
    law = FeedbackLaw(np.zeros((steps, m)), np.zeros((steps, m, n)))
    v_x, v_xx = np.zeros(n), np.zeros((n, n))
    warm_start = np.zeros(m)
    for k in reversed(range(steps)):
        transition = model.transition[k]
        q_z = model.gradient[k] + transition.T @ v_x
        q_zz = model.hessian[k] + transition.T @ v_xx @ transition
        q_uu = q_zz[n:, n:] + regularisation * np.eye(m)
        limits = low - controls[k], high - controls[k]
        offset, free = box_qp(q_uu, q_z[n:], *limits, warm_start)
        gain = np.zeros((m, n))
        if free.any():
            gain[free] = -_solve(q_uu[np.ix_(free, free)], q_zz[n:][free, :n])
        closed = np.concatenate([np.eye(n), gain])  # z by x, under the law
        v_x = closed.T @ (q_z + q_zz[:, n:] @ offset)
        v_xx = closed.T @ q_zz @ closed
        v_xx = (v_xx + v_xx.T) / 2
        law.offset[k], law.gain[k] = offset, gain
        warm_start = offset
    return law
