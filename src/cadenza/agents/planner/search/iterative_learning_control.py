"""Iterative learning control: updates controls by the fingertip errors of the last rollout."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.tracking import discretised
from cadenza.agents.planner.search.fingertip_correction import normal_equations
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]

TOLERANCE = 0.002
"""[m] of a playing fingertip's error that costs as much as changing a control by its noise."""


def control_update(
    error: Array, weight: Array, jacobian: Array, feedback: Array, servos: Servos, dt: float
) -> Array:
    """(S, A) what to add to the controls of S steps.

    Norm-optimal iterative learning control (Amann, Owens & Rogers, Iterative Learning Control Using
    Optimal Feedback and Feedforward Actions, 1996): minimises the squared errors that are left and
    the squared changes, by the Riccati recursion. The model is linear, without contacts, and each
    servo moves by itself, as in `track`. Its state x are the deviations of positions and speeds.

    Args:
        error: (S, F, 3) from fingertips after each step to where they should be [m].
        weight: (S, F) of the squared errors, 1 for fingers that play.
        jacobian: (S, F, 3, A) derivatives of fingertips by servos.
        feedback: (S, A, 2) gains that are active meanwhile, see `Tracking`.
        servos: of the hand; one with more noise changes more.
        dt: control step [s].
    """
    steps, count = len(error), len(servos.noise)
    hessian, gradient = normal_equations(error, weight, jacobian, TOLERANCE)
    transition, control = _closed_loop(feedback, servos, dt)
    value_hessian, value_gradient = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    gain, offset = np.zeros((steps, count, 2 * count)), np.zeros((steps, count))
    for t in reversed(range(steps)):
        value_hessian[:count, :count] += hessian[t]
        value_gradient[:count] -= gradient[t]
        by_control = control.T @ value_hessian
        q_uu = np.diag(servos.noise**-2.0) + by_control @ control
        q_ux, q_u = by_control @ transition[t], control.T @ value_gradient
        minimiser = -np.linalg.solve(q_uu, np.column_stack([q_ux, q_u]))
        gain[t], offset[t] = minimiser[:, :-1], minimiser[:, -1]
        closed = transition[t] + control @ gain[t]
        value_hessian = transition[t].T @ value_hessian @ closed
        value_gradient = closed.T @ value_gradient
        value_hessian = (value_hessian + value_hessian.T) / 2
    update, x = np.zeros((steps, count)), np.zeros(2 * count)
    for t in range(steps):
        update[t] = offset[t] + gain[t] @ x
        x = transition[t] @ x + control @ update[t]
    return update


def _closed_loop(feedback: Array, servos: Servos, dt: float) -> tuple[Array, Array]:
    """Derivatives of x after a step by x, (S, 2 A, 2 A), and by the controls, (2 A, A)."""
    by_state, by_control = discretised(servos, dt)
    by_servo = by_state - by_control[:, :, None] * feedback[:, :, None, :]  # (S, A, 2, 2)
    count = feedback.shape[1]
    servo = np.arange(count)
    transition = np.zeros((len(feedback), 2 * count, 2 * count))
    for row in range(2):
        for column in range(2):
            transition[:, row * count + servo, column * count + servo] = by_servo[..., row, column]
    return transition, np.concatenate([np.diag(each) for each in by_control.T])
