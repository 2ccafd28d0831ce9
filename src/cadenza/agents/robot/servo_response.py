"""How servos respond to controls that arrive late, and the controls of a wanted response."""

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

_SETTLED = 2.0  # [s] after which nothing is left of the response to a control step
_ITERATIONS = 100  # of the optimisation of controls
_PENALTY = 0.3  # of controls that a servo is too slow for, which decides how fast it converges

# Among what those of a robot are found: delays, and factors of the damping and the speed of servos.
_DELAYS = np.arange(0.0, 0.15, 0.005)  # [s]
_DAMPING = np.array([0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0])
_FINER = np.geomspace(0.75, 1.33, 9)  # factors beside the best of these
_RECENT = 4  # plays from which it is found
_SPEEDS = 0.75, 0.85, 1.0, 1.2, 1.5


class Response(NamedTuple):
    """What is known of how A servos respond."""

    late: float
    """For how long controls are on their way [s]."""
    damping: Array
    """(A,) factors of their damping."""
    fastest: Array
    """(A,) by how much setpoints change at most in a control step [m, rad]."""


def usual_response(servos: Servos, dt: float, known: DomainRandomization) -> Response:
    """Response in the middle of what robots are drawn from."""
    same, sweep = np.ones(len(servos.low)), sum(known.sweep_time) / 2
    fastest = (servos.high - servos.low) * dt / sweep if sweep else np.inf * same
    return Response(sum(known.latency) / 2, same, fastest)


class ServoResponse:
    """The response of A servos, each by itself and without load, to controls that arrive late.

    Controls and positions are differences from others, or from where servos are at the beginning.
    """

    def __init__(self, servos: Servos, dt: float, known: Response) -> None:
        """Compute the response to one control step of `dt` [s]."""
        self._fastest = known.fastest
        servos = replace(servos, damping=servos.damping * known.damping)
        whole, part = divmod(round(known.late, 9), dt)
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

    def limited(self, controls: Array) -> Array:
        """(T, A) setpoints that follow controls (T, A) from the beginning as fast as they can."""
        setpoints = np.concatenate([np.zeros_like(controls[:1]), controls])
        for before, now in pairwise(setpoints):
            now[:] = before + (now - before).clip(-self._fastest, self._fastest)
        return setpoints[1:]

    def controls(self, before: Array, change: Array, cost: Array) -> Array:
        """(T, A) controls near those `before` that change the response by `change` (T, A).

        Squared errors are least together with squared changes of controls, which cost so much (A,),
        among controls that no servo is too slow for: norm-optimal iterative learning control with
        constraints (Chu & Owens 2010), of a song that ends in silence, by the alternating direction
        method of multipliers (Boyd et al. 2011).
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
        wanted = np.array([np.correlate(error, row, "valid") for error, row in errors])
        begin, most = np.diff(before.T, prepend=0.0), self._fastest[:, None]
        feasible, dual = begin.clip(-most, most), np.zeros_like(begin)
        for _ in range(_ITERATIONS):
            right = wanted - _PENALTY * np.diff(feasible - dual - begin, append=0.0)
            found = cho_solve_banded((factors, True), right.ravel()).reshape(begin.shape)
            moved = begin + np.diff(found, prepend=0.0)
            feasible = (moved + dual).clip(-most, most)
            dual += moved - feasible
        return self.limited(before + found.T)


def identified(
    servos: Servos,
    dt: float,
    plays: Sequence[tuple[Array, Array]],
    usual: Array,
    late: float | None = None,
) -> Response:
    """How servos respond that were sent controls (T, A) in the last `plays`, and moved so (T, A).

    The delay is the same for all, and contains that of sensors; `late` tells it if it is known [s].
    `usual` (A,) is by how much setpoints change at most in a control step, about.
    """

    plays = plays[-_RECENT:]

    def errors(late: float, damping: float | Array) -> Array:
        known = Response(late, damping * np.ones_like(usual), usual)
        response = ServoResponse(servos, dt, known)
        off = [[play[1] - response.to(c) for play, c in zip(plays, s, strict=True)] for s in slow]
        return np.square(off).mean(axis=(1, 2))

    ones = np.ones_like(usual)
    speeds = [ServoResponse(servos, dt, Response(0.0, ones, usual * s)) for s in _SPEEDS]
    slow = [[each.limited(sent) for sent, _ in plays] for each in speeds]
    if late is None:
        late = min(_DELAYS, key=lambda late: errors(late, 1.0).min(axis=0).sum())
    # What is far from nominal has to explain more, as a hand that is caught looks slow, too.
    found = np.array([errors(late, d) * (1.0 + np.log(d) ** 2) for d in _DAMPING])
    best = found.reshape(-1, len(usual)).argmin(axis=0)
    damping, speed = np.take(_DAMPING, best // len(_SPEEDS)), np.take(_SPEEDS, best % len(_SPEEDS))
    finer = [errors(late, damping * f)[best % len(_SPEEDS), np.arange(len(usual))] for f in _FINER]
    damping = damping * np.take(_FINER, np.argmin(finer, axis=0))
    return Response(float(late), damping, usual * speed)
