"""Control-limited differential dynamic programming: the part that knows nothing of the piano.

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

_ENOUGH = 1e-9  # length of the free gradient, relative to the whole at the start
_MOST_NEWTON_STEPS = 100
_ARMIJO = 0.1
_SHRINK = 0.6


class Model(NamedTuple):
    """K steps in quadratic approximation; n states x and m controls u make up z = (x, u)."""

    transition: Array
    """(K, n, n + m) derivatives of the next state by z."""
    gradient: Array
    """(K, n + m) of a step's cost by z."""
    hessian: Array
    """(K, n + m, n + m) of a step's cost by z."""


class FeedbackLaw(NamedTuple):
    """Changes of the controls: `offset` + `gain` times how far the state is from the nominal."""

    offset: Array
    """(K, m)."""
    gain: Array
    """(K, m, n); its rows are zero for controls at a limit."""


def box_qp(
    hessian: Array, gradient: Array, low: Array, high: Array, start: Array
) -> tuple[Array, Mask]:
    """Minimises x'Hx / 2 + g'x over low <= x <= high by projected Newton steps (the paper, III-B).

    Args:
        hessian: (m, m).
        gradient: (m,).
        low: (m,).
        high: (m,).
        start: (m,) where to begin.

    Returns:
        The solution (m,), and which of its elements are free (m,), not held at a limit.

    Raises:
        np.linalg.LinAlgError: the Hessian is not positive definite in the free directions.
    """
    x = np.clip(start, low, high)
    enough = _ENOUGH * (np.linalg.norm(gradient) + np.linalg.norm(hessian @ x))
    for _ in range(_MOST_NEWTON_STEPS):
        slope = gradient + hessian @ x
        free = ~(((x <= low) & (slope > 0)) | ((x >= high) & (slope < 0)))
        if np.linalg.norm(slope[free]) <= enough:
            break
        step = np.zeros_like(x)
        step[free] = -_solve(hessian[np.ix_(free, free)], slope[free])
        x, before = _search(hessian, slope, x, step, low, high), x
        if (x == before).all():
            break
    return x, free


def _search(hessian: Array, slope: Array, x: Array, step: Array, low: Array, high: Array) -> Array:
    """The longest step along the projected `step` that decreases the cost enough (Armijo)."""
    size = 1.0
    while size > 1e-12:
        end = np.clip(x + size * step, low, high)
        change = end - x
        if slope @ change + change @ hessian @ change / 2 <= _ARMIJO * (slope @ change):
            return end  # not x + change, which may miss a limit by a rounding
        size *= _SHRINK
    return x


def _solve(matrix: Array, right: Array) -> Array:
    return np.asarray(cho_solve(cho_factor(matrix), right))


def backward_pass(
    model: Model, controls: Array, low: Array, high: Array, regularisation: float
) -> FeedbackLaw:
    """The law that minimises the quadratic model within the limits (the paper, III-C).

    Args:
        model: of K steps; after the last nothing costs.
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
    value_gradient, value_hessian = np.zeros(n), np.zeros((n, n))
    warm = np.zeros(m)
    for k in reversed(range(steps)):
        transition = model.transition[k]
        q = model.gradient[k] + transition.T @ value_gradient
        qq = model.hessian[k] + transition.T @ value_hessian @ transition
        damped = qq[n:, n:] + regularisation * np.eye(m)
        limits = low - controls[k], high - controls[k]
        offset, free = box_qp(damped, q[n:], *limits, warm)
        gain = np.zeros((m, n))
        if free.any():
            gain[free] = -_solve(damped[np.ix_(free, free)], qq[n:][free, :n])
        closed = np.concatenate([np.eye(n), gain])  # z by x, under the law
        value_gradient = closed.T @ (q + qq[:, n:] @ offset)
        value_hessian = closed.T @ qq @ closed
        value_hessian = (value_hessian + value_hessian.T) / 2
        law.offset[k], law.gain[k] = offset, gain
        warm = offset
    return law
