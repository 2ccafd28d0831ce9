"""Iterative learning control: changes controls by how far fingertips missed as they were played."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.tracking import discretised
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]

NEAR = 0.002  # [m] that a playing fingertip may miss by, as soon as a servo may move like noise


def changes(
    off: Array, weight: Array, motion: Array, gain: Array, servos: Servos, sigma: Array, dt: float
) -> Array:
    """(S, A) what to add to the controls of S steps of a hand of A servos and F fingers.

    It would take fingertips to where they should have been if nothing were touched and each servo
    moved by itself, as in `track`: norm-optimal iterative learning control (Amann, Owens & Rogers,
    Iterative Learning Control Using Optimal Feedback and Feedforward Actions, 1996). It minimises
    the squares of what is left of the ways and, much less, of the changes, by the Riccati
    recursion.

    Args:
        off: (S, F, 3) ways from where fingertips were after each step to where they should be [m].
        weight: (S, F) how much they count, 1 for fingers that play.
        motion: (S, F, 3, A) how fingertips move with the servos.
        gain: (S, A, 2) of the feedback that goes on meanwhile, see `Tracking`.
        servos: of the hand.
        sigma: (A,) how far noise moves them; one that it moves further changes more.
        dt: control step [s].
    """
    steps, count = off.shape[0], len(sigma)
    slope = motion.reshape(steps, -1, count)
    pull = slope.transpose(0, 2, 1) * np.repeat(weight, 3, axis=1)[:, None] / NEAR**2
    square = pull @ slope
    towards = (pull @ off.reshape(steps, -1, 1))[..., 0]
    closed, push = _closed(gain, servos, dt)
    value, rise = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    back, onward = np.zeros((steps, count, 2 * count)), np.zeros((steps, count))
    for t in range(steps - 1, -1, -1):
        value[:count, :count] += square[t]
        rise[:count] -= towards[t]
        pushed = push.T @ value
        curvature = np.diag(sigma**-2.0) + pushed @ push
        solved = np.linalg.solve(curvature, np.column_stack([pushed @ closed[t], push.T @ rise]))
        back[t], onward[t] = solved[:, :-1], -solved[:, -1]
        left = closed[t] - push @ back[t]
        value, rise = closed[t].T @ value @ left, left.T @ rise
        value = (value + value.T) / 2
    change, state = np.zeros((steps, count)), np.zeros(2 * count)
    for t in range(steps):
        change[t] = onward[t] - back[t] @ state
        state = closed[t] @ state + push @ change[t]
    return change


def _closed(gain: Array, servos: Servos, dt: float) -> tuple[Array, Array]:
    """(S, 2 A, 2 A) what steps make of positions and speeds, and (2 A, A) of changed controls."""
    step, push = discretised(servos, dt)
    alone = step - push[:, :, None] * gain[:, :, None, :]
    count = gain.shape[1]
    servo = np.arange(count)
    closed = np.zeros((len(gain), 2 * count, 2 * count))
    for row in range(2):
        for column in range(2):
            closed[:, row * count + servo, column * count + servo] = alone[:, :, row, column]
    return closed, np.concatenate([np.diag(along) for along in push.T])
