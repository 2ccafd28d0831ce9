"""How servos respond to controls that arrive late, and the controls of a wanted response."""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_toeplitz

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.tracking import discretised
from cadenza.scene.servos import Servos

_SETTLED = 2.0  # [s] after which nothing is left of the response to a control step


class ServoResponse:
    """The response of A servos, each by itself and without load, to controls that arrive late.

    Everything is linear: controls and responses are differences from others.
    """

    def __init__(self, servos: Servos, dt: float, late: float) -> None:
        """Compute the response to one control step of `dt` [s] that is `late` [s]."""
        whole, part = divmod(round(late, 9), dt)
        step, push = discretised(servos, dt)
        state, rows = discretised(servos, dt - part)[1], [np.zeros(len(push))] * int(whole)
        for _ in range(round(_SETTLED / dt)):
            rows.append(state[:, 0])
            state = np.einsum("aij,aj->ai", step, state) + push
        self._impulse = np.diff(rows, axis=0, prepend=0.0).T

    def to(self, controls: Array) -> Array:
        """(T, A) positions after each step, by controls (T, A)."""
        pairs = zip(controls.T, self._impulse, strict=True)
        return np.stack([np.convolve(*pair)[: len(controls)] for pair in pairs], axis=1)

    def inverse(self, wanted: Array, cost: float) -> Array:
        """(T, A) controls to which the response is as `wanted` (T, A), in least squares.

        Squared controls cost so much beside squared errors: norm-optimal iterative learning control
        (Amann, Owens & Rogers 1996), of a song that ends in silence.
        """
        steps = len(wanted)
        controls = np.zeros_like(wanted)
        for servo, impulse in enumerate(self._impulse):
            size = len(impulse)
            row = np.zeros(steps)
            correlation = np.correlate(impulse, impulse, "full")[size - 1 :][:steps]
            row[: len(correlation)] = correlation
            row[0] += cost
            right = np.correlate(np.pad(wanted[:, servo], (0, size - 1)), impulse, "valid")
            controls[:, servo] = solve_toeplitz(row, right)
        return controls
