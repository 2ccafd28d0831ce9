"""Changes of servos and of controls that take fingertips to their targets."""

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.tracking import discretised
from cadenza.scene.servos import Servos

MAX_ERROR = 0.03
"""Length to which fingertip errors are clipped, so that no finger outweighs the others [m]."""
CONTROL_TOLERANCE = 0.002
"""Error of a playing fingertip with the cost of changing a control by its noise [m]."""
_SERVO_TOLERANCE = 0.001  # [m] error with the cost of moving a servo by its noise


def servo_corrections(error: Array, weight: Array, jacobian: Array, servos: Servos) -> Array:
    """Changes (H, A) of servos that reduce the fingertip errors of H steps.

    Each step is solved by itself, by damped least squares (Wampler, Manipulator Inverse Kinematic
    Solutions Based on Vector Formulations and Damped Least-Squares Methods, 1986). A servo with
    more noise is damped less.

    Args:
        error: (H, F, 3) targets of fingertips less their positions [m].
        weight: (H, F) weights of the squared errors, 1 for playing fingers.
        jacobian: (H, F, 3, A) derivatives of fingertips by servos.
        servos: the servos of the hand.
    """
    hessian, gradient = _normal_equations(
        clipped(error), weight, jacobian * servos.noise, _SERVO_TOLERANCE
    )
    damped = hessian + np.eye(len(servos.noise))
    return np.asarray(np.linalg.solve(damped, gradient[..., None])[..., 0] * servos.noise)


def control_update(
    error: Array, weight: Array, jacobian: Array, feedback: Array, servos: Servos, dt: float
) -> Array:
    """Changes (H, A) of the controls of H steps that reduce the fingertip errors after them.

    Norm-optimal iterative learning control (Amann, Owens & Rogers, Iterative Learning Control Using
    Optimal Feedback and Feedforward Actions, 1996) minimises the squared remaining errors plus the
    squared changes, by the Riccati recursion. The model is linear, without contacts, and has
    independent servos, as in `track`. Its state x is the deviations of positions and speeds.

    Args:
        error, weight, jacobian: as in `servo_corrections`.
        feedback: (H, A, 2) gains of the feedback, see `Tracking`.
        servos: the servos of the hand; a control with more noise changes more.
        dt: control step [s].
    """
    steps, count = len(error), len(servos.noise)
    hessian, gradient = _normal_equations(error, weight, jacobian, CONTROL_TOLERANCE)
    transition, control = _closed_loop(feedback, servos, dt)
    value_hessian, value_gradient = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    gain, offset = np.zeros((steps, count, 2 * count)), np.zeros((steps, count))
    for t in reversed(range(steps)):
        value_hessian[:count, :count] += hessian[t]
        value_gradient[:count] -= gradient[t]
        by_control = control.T @ value_hessian
        q_uu = np.diag(servos.noise**-2.0) + by_control @ control
        q_ux, q_u = by_control @ transition[t], control.T @ value_gradient
        solution = -np.linalg.solve(q_uu, np.column_stack([q_ux, q_u]))
        gain[t], offset[t] = solution[:, :-1], solution[:, -1]
        closed_loop = transition[t] + control @ gain[t]
        value_hessian = transition[t].T @ value_hessian @ closed_loop
        value_gradient = closed_loop.T @ value_gradient
        value_hessian = (value_hessian + value_hessian.T) / 2
    update, x = np.zeros((steps, count)), np.zeros(2 * count)
    for t in range(steps):
        update[t] = offset[t] + gain[t] @ x
        x = transition[t] @ x + control @ update[t]
    return update


def clipped(error: Array) -> Array:
    """Errors (H, F, 3) [m], shortened to `MAX_ERROR` where they are longer."""
    length = np.linalg.norm(error, axis=2, keepdims=True)
    return error * (MAX_ERROR / np.maximum(length, MAX_ERROR))


def _normal_equations(
    error: Array, weight: Array, jacobian: Array, tolerance: float
) -> tuple[Array, Array]:
    """J'WJ (H, A, A) and J'We (H, A) of weighted errors (H, F, 3), in units of `tolerance` [m]."""
    steps = len(error)
    rows = jacobian.reshape(steps, -1, jacobian.shape[-1])
    weighted = rows.transpose(0, 2, 1) * np.repeat(weight, 3, axis=1)[:, None] / tolerance**2
    return weighted @ rows, (weighted @ error.reshape(steps, -1, 1))[..., 0]


def _closed_loop(feedback: Array, servos: Servos, dt: float) -> tuple[Array, Array]:
    """Derivatives of x after a step by x, (H, 2 A, 2 A), and by the controls, (2 A, A)."""
    by_state, by_control = discretised(servos, dt)
    by_servo = by_state - by_control[:, :, None] * feedback[:, :, None, :]  # (H, A, 2, 2)
    count = feedback.shape[1]
    servo = np.arange(count)
    transition = np.zeros((len(feedback), 2 * count, 2 * count))
    for row in range(2):
        for column in range(2):
            transition[:, row * count + servo, column * count + servo] = by_servo[..., row, column]
    return transition, np.concatenate([np.diag(column_values) for column_values in by_control.T])
