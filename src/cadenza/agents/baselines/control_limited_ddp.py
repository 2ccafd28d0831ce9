"""Control-limited differential dynamic programming (Tassa, Mansard, Todorov, ICRA 2014)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from cadenza.agents.agent import Array, Mask

_TOLERANCE = 1e-9  # norm of the free gradient, relative to the gradient at the start
_MAX_NEWTON_STEPS = 100
_ARMIJO = 0.1  # share of the decrease that the gradient predicts
_BACKTRACKING = 0.6  # factor between step sizes
_MIN_STEP_SIZE = 1e-12  # below which rounding errors decide


class Model(NamedTuple):
    """Quadratic model of K steps, with n states x and m controls u that make up z = (x, u)."""

    transition: Array  # (K, n, n + m) derivatives of the next state by z
    gradient: Array  # (K, n + m) the gradient of a step's cost by z
    hessian: Array  # (K, n + m, n + m) the Hessian of a step's cost by z


class FeedbackLaw(NamedTuple):
    """Changes of the controls, k + K dx, where dx is the deviation from the nominal states."""

    offset: Array  # (K, m) k of each step
    gain: Array  # (K, m, n) K of each step; its rows are zero for controls at a limit


def box_qp(
    hessian: Array, gradient: Array, low: Array, high: Array, start: Array
) -> tuple[Array, Mask]:
    """Minimise x'Hx / 2 + g'x over low <= x <= high by projected Newton steps (Tassa 2014, III-B).

    The Hessian is (m, m), all others (m,); `start` is the initial guess. Returns the solution (m,),
    and which of its elements are free (m,), not held at a limit.

    Raises:
        np.linalg.LinAlgError: the Hessian is not positive definite in the free directions.
    """
    x = np.clip(start, low, high)
    tolerance = _TOLERANCE * (np.linalg.norm(gradient) + np.linalg.norm(hessian @ x))
    for _ in range(_MAX_NEWTON_STEPS):
        slope = gradient + hessian @ x
        free = ~(((x <= low) & (slope > 0)) | ((x >= high) & (slope < 0)))
        if np.linalg.norm(slope[free]) <= tolerance:
            break
        step = np.zeros_like(x)
        step[free] = -_solve(hessian[np.ix_(free, free)], slope[free])
        x, previous = _line_search(hessian, slope, x, step, low, high), x
        if (x == previous).all():
            break
    return x, free


def _line_search(
    hessian: Array, gradient: Array, x: Array, step: Array, low: Array, high: Array
) -> Array:
    """End (m,) of the longest projected step from `x` that meets the Armijo condition."""
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
    """Feedback law that minimises the quadratic model within the limits (Tassa 2014, III-C).

    The nominal `controls` (K, m) have the limits `low` and `high` (m,); there is no terminal cost.
    `regularisation` is added to the diagonal of the control Hessian (Levenberg-Marquardt).

    Raises:
        np.linalg.LinAlgError: more regularisation is needed.
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
        closed_loop = np.concatenate([np.eye(n), gain])  # z by x, under the law
        v_x = closed_loop.T @ (q_z + q_zz[:, n:] @ offset)
        v_xx = closed_loop.T @ q_zz @ closed_loop
        v_xx = (v_xx + v_xx.T) / 2
        law.offset[k], law.gain[k] = offset, gain
        warm_start = offset
    return law
