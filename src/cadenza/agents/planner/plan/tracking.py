"""Controls that make the servos follow postures: feed-forward of their lag, and feedback."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.fingertip_targets import by_hand
from cadenza.scene.servos import Servos

Steps = int | NDArray[np.intp]

_MAX_CACHED = 2000  # steps of plans whose gains are cached, 2 kB each for two hands
# Weight of a control's squared distance from `Servos.lead`, beside 1 for that of the servo from the
# reference: small, so that the servo is in place, but not 0, so that controls are calm.
_CONTROL_WEIGHT = 0.02


class Tracking(NamedTuple):
    """Controls over T steps that make the servos follow a reference; see `track`."""

    ctrl: Array  # (T, A)
    gain: Array  # (T, A, 2) gains of the feedback of position and speed
    expected: Array  # (T + 1, A, 2) position and speed of each servo

    def of(self, servos: slice) -> Tracking:
        """Tracking of the servos in a slice, as views."""
        return Tracking._make(values[:, servos] for values in self)

    def by_hand(self, hands: int) -> Tracking:
        """Tracking of H hands with A servos each, (T, H, A, ...), as views."""
        return Tracking._make(by_hand(values, hands) for values in self)

    def feedback(self, step: Steps, state: Array) -> Array:
        """Feedback (..., A) at positions and speeds (..., A, 2), to subtract from controls."""
        return (self.gain[step] * (state - self.expected[step])).sum(axis=-1)

    def controls(self, servos: Servos, step: Steps, state: Array) -> Array:
        """Controls (..., A) with feedback at positions and speeds (..., A, 2), within range."""
        return servos.clip(self.ctrl[step] - self.feedback(step, state))


def track(servos: Servos, reference: Array, start: Array, offset: Array, dt: float) -> Tracking:
    """Track `reference` (T + 1, A), whose first row is the current position of the servos.

    The model of a servo is a mass on a damped spring whose other end is the control, held for
    `dt` [s]. The controls minimise the squared distance from the reference, and with a small weight
    their own from `Servos.lead`, within their ranges: a linear-quadratic tracker (e.g. Anderson &
    Moore, Optimal Control: Linear Quadratic Methods, 1990, chapter 4), solved for all servos at
    once by the Riccati recursion.

    Args:
        servos: the A servos.
        reference: positions before the first step and after each step.
        start: (A, 2) positions and speeds before the first step.
        offset: (T, A) changes of the controls that compensate external forces.
        dt: time between steps [s].
    """
    step, push = discretised(servos, dt)
    steps, count = len(reference) - 1, len(servos.low)
    feedback = _cached_feedback if steps <= _MAX_CACHED else _feedback
    gain, curvature, closed_loop = feedback(servos, dt, steps)
    before, now, after = servos.lead(dt)
    previous = np.concatenate([reference[:1] - dt * start[:, 1], reference[:-2]])
    leading = before * previous + now * reference[:-1] + after * reference[1:]
    leading = servos.clip(leading)
    feedforward = np.zeros((steps, count))
    linear = np.zeros((count, 2))  # term of the cost-to-go, see `_feedback`
    for t in range(steps - 1, -1, -1):
        linear[:, 0] -= reference[t + 1]
        weighted = _CONTROL_WEIGHT * leading[t]
        feedforward[t] = (weighted - np.vecdot(push, linear)) / curvature[t]
        linear = np.einsum("aji,aj->ai", closed_loop[t], linear) + gain[t] * weighted[:, None]
    expected = np.zeros((steps + 1, count, 2))
    expected[0] = start
    ctrl = np.zeros((steps, count))
    for t in range(steps):
        ctrl[t] = servos.clip(feedforward[t] - np.vecdot(gain[t], expected[t]))
        expected[t + 1] = np.einsum("aij,aj->ai", step, expected[t]) + push * ctrl[t][:, None]
    return Tracking(servos.clip(ctrl + offset), gain, expected)


def _feedback(servos: Servos, dt: float, steps: int) -> tuple[Array, Array, Array]:
    """Solve the Riccati recursion, which does not depend on the reference.

    Returns the gains (T, A, 2), the curvature (T, A) of the cost-to-go as a function of the
    control, and the closed-loop transition (T, A, 2, 2) of position and speed.
    """
    step, push = discretised(servos, dt)
    count = len(servos.low)
    gain, curvature = np.zeros((steps, count, 2)), np.zeros((steps, count))
    closed_loop = np.zeros((steps, count, 2, 2))
    value = np.zeros((count, 2, 2))  # the cost-to-go is x' value x / 2 + linear' x
    for t in range(steps - 1, -1, -1):
        value[:, 0, 0] += 1.0
        pushed = np.einsum("aij,aj->ai", value, push)
        curvature[t] = _CONTROL_WEIGHT + np.vecdot(push, pushed)
        gain[t] = np.einsum("ai,aij->aj", pushed, step) / curvature[t][:, None]
        closed_loop[t] = step - push[:, :, None] * gain[t][:, None, :]
        value = np.einsum("aji,ajk->aik", step, value @ closed_loop[t])
        value = (value + value.transpose(0, 2, 1)) / 2
    for values in (gain, curvature, closed_loop):
        values.flags.writeable = False
    return gain, curvature, closed_loop


_cached_feedback = lru_cache(maxsize=8)(_feedback)  # most of the time of short plans


@lru_cache(maxsize=8)
def discretised(servos: Servos, dt: float) -> tuple[Array, Array]:
    """Transition (A, 2, 2) of position and speed in a step of `dt` [s], and (A, 2) of control."""
    k, d, m = servos.stiffness, servos.damping, servos.inertia
    motion = np.zeros((len(k), 3, 3))
    motion[:, 0, 1] = 1.0
    motion[:, 1] = np.stack([-k / m, -d / m, k / m], axis=1)
    exact = expm(motion * dt)
    return exact[:, :2, :2], exact[:, :2, 2]
