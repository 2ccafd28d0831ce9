"""The response of servos to controls that arrive late, its identification and its inverse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from cadenza.agents.agent import Array
from cadenza.agents.planner.plan.tracking import discretised
from cadenza.scene.servos import Servos
from cadenza.tasks.config import DomainRandomization

_SETTLED = 2.0  # [s] after which the response to a control step is over
_ITERATIONS = 100  # iterations of the optimisation of controls
_PENALTY = 0.3  # on controls that are too fast for a servo, which determines the convergence

# The grid for identification: delays, and factors of the damping and the speed of servos.
_DELAYS = np.arange(0.0, 0.15, 0.005)  # [s]
_DAMPING = np.array([0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0])
_FINER = np.geomspace(0.75, 1.33, 9)  # factors around the best of these
_RECENT = 4  # plays that count
_SPEEDS = 0.75, 0.85, 1.0, 1.2, 1.5


class Response(NamedTuple):
    """Parameters of the response of A servos."""

    late: float
    """Delay of controls [s]."""
    damping: Array
    """(A,) factors of their damping."""
    fastest: Array
    """(A,) maximum changes of setpoints in a control step [m, rad]."""


def usual_response(servos: Servos, dt: float, ranges: DomainRandomization) -> Response:
    """Response in the middle of the ranges from which robots are drawn."""
    speed = servos.of_each(sum(ranges.joint_speed), sum(ranges.slide_speed)) / 2
    fastest = np.where(speed > 0, speed * dt, np.inf)
    return Response(sum(ranges.latency) / 2, np.ones_like(speed), fastest)


class ServoResponse:
    """The response of A independent servos, without load, to controls that arrive late.

    Controls and positions are differences from the start, or between two motions.
    """

    def __init__(self, servos: Servos, dt: float, response: Response) -> None:
        """Compute the response to one control step of `dt` [s]."""
        self._fastest = response.fastest
        servos = replace(servos, damping=servos.damping * response.damping)
        steps, part = divmod(round(response.late, 9), dt)
        step, push = discretised(servos, dt)
        state, rows = discretised(servos, dt - part)[1], [np.zeros(len(push))] * int(steps)
        for _ in range(round(_SETTLED / dt)):
            rows.append(state[:, 0])
            state = np.einsum("aij,aj->ai", step, state) + push
        self._impulse = np.diff(rows, axis=0, prepend=0.0).T

    def to(self, controls: Array) -> Array:
        """Positions (T, A) after each step, for controls (T, A)."""
        pairs = zip(controls.T, self._impulse, strict=True)
        return np.stack([np.convolve(*pair)[: len(controls)] for pair in pairs], axis=1)

    def limited(self, controls: Array) -> Array:
        """Setpoints (T, A) that follow controls (T, A) from the start with limited speed."""
        setpoints = np.concatenate([np.zeros_like(controls[:1]), controls])
        for before, now in pairwise(setpoints):
            now[:] = before + (now - before).clip(-self._fastest, self._fastest)
        return setpoints[1:]

    def controls(self, before: Array, change: Array, cost: Array) -> Array:
        """Controls (T, A) near those `before` that change the response by `change` (T, A).

        They minimise squared errors plus squared changes of controls, weighted by `cost` (A,),
        within the speed of the servos: norm-optimal iterative learning control with constraints
        (Chu & Owens 2010), of a song that ends in silence, by the alternating direction method of
        multipliers (Boyd et al. 2011).
        """
        steps, size = len(before), self._impulse.shape[1]
        band = np.zeros((min(size, steps), before.shape[1], steps))
        for k, diagonal in enumerate(band):
            pairs = self._impulse[:, : size - k] * self._impulse[:, k:]
            diagonal[:, : steps - k] = pairs.sum(axis=1)[:, None]
        band[0] += np.reshape(cost, (-1, 1)) + 2 * _PENALTY
        band[0, :, -1] -= _PENALTY
        band[1, :, :-1] -= _PENALTY
        factors = cholesky_banded(band.reshape(len(band), -1), lower=True)
        padded = np.pad(change.T, ((0, 0), (0, size - 1)))
        errors = zip(padded, self._impulse, strict=True)
        correlation = np.array([np.correlate(error, row, "valid") for error, row in errors])
        begin, fastest = np.diff(before.T, prepend=0.0), self._fastest[:, None]
        feasible, dual = begin.clip(-fastest, fastest), np.zeros_like(begin)
        for _ in range(_ITERATIONS):
            right = correlation - _PENALTY * np.diff(feasible - dual - begin, append=0.0)
            solution = cho_solve_banded((factors, True), right.ravel()).reshape(begin.shape)
            steps_of_controls = begin + np.diff(solution, prepend=0.0)
            feasible = (steps_of_controls + dual).clip(-fastest, fastest)
            dual += steps_of_controls - feasible
        return self.limited(before + solution.T)


def identified(
    servos: Servos,
    dt: float,
    plays: Sequence[tuple[Array, Array]],
    usual: Array,
    late: float | None = None,
) -> Response:
    """Identify the response of servos from plays: pairs of controls (T, A) and positions (T, A).

    Only the last plays count. All servos have the same delay, which contains that of sensors;
    `late` is its value if it is known [s]. `usual` (A,) are the usual maximum changes of setpoints
    in a control step.
    """

    plays = plays[-_RECENT:]

    def errors(late: float, damping: float | Array) -> Array:
        parameters = Response(late, damping * np.ones_like(usual), usual)
        response = ServoResponse(servos, dt, parameters)
        residuals = [
            [positions - response.to(controls) for (_, positions), controls in pairs]
            for pairs in (list(zip(plays, setpoints, strict=True)) for setpoints in limited)
        ]
        return np.square(residuals).mean(axis=(1, 2))

    ones = np.ones_like(usual)
    speeds = [ServoResponse(servos, dt, Response(0.0, ones, usual * s)) for s in _SPEEDS]
    limited = [[speed.limited(controls) for controls, _ in plays] for speed in speeds]
    if late is None:
        late = min(_DELAYS, key=lambda late: errors(late, 1.0).min(axis=0).sum())
    # A penalty on values far from nominal, as a caught hand looks slow, too.
    costs = np.array([errors(late, d) * (1.0 + np.log(d) ** 2) for d in _DAMPING])
    best = costs.reshape(-1, len(usual)).argmin(axis=0)
    damping, speed = np.take(_DAMPING, best // len(_SPEEDS)), np.take(_SPEEDS, best % len(_SPEEDS))
    finer = [errors(late, damping * f)[best % len(_SPEEDS), np.arange(len(usual))] for f in _FINER]
    damping = damping * np.take(_FINER, np.argmin(finer, axis=0))
    return Response(float(late), damping, usual * speed)
