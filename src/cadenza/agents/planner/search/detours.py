"""Ways for a hand to get off what it is caught by: it, or some of its fingers, are lifted."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.control_steps import steps_in
from cadenza.scene.servos import Servos

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_LIFTED = (0.05, 0.1)  # [s] for which a hand lifts itself where it is caught between keys
_DETOURS = (0.1, 0.2, 0.3)  # [s] for which it or fingers are lifted
_STRAIGHT_UP = 0.1  # [s] of them: what pushes against a key is kept from rising by friction


class Detours:
    """Makes them of plans (H, A)."""

    def __init__(self, servos: Servos, dt: float) -> None:
        """Args:
        servos: of the hand.
        dt: control step [s].
        """
        self._servos, self._dt = servos, dt

    def lifted(self, plan: Array, step: int) -> Array:
        """(H, A) the plan, with the hand lifted for a time that changes from step to step."""
        seconds = _LIFTED[step % len(_LIFTED)]
        return self._servos.clip(plan + self._lift(self._servos.lift, seconds, len(plan)))

    def some(self, plan: Array, caught: Mask, posture: Array, step: int) -> Array:
        """(3, H, A) ways around what fingers are caught by, for a time that changes likewise.

        Args:
            plan: (H, A)
            caught: (F,) which fingers.
            posture: (A,) of the hand now.
            step: the first one.
        """
        return self._around(plan, caught, posture, 0.0)[step % len(_DETOURS) :: len(_DETOURS)]

    def all(self, plan: Array, caught: Mask, posture: Array) -> Array:
        """(D, H, A) such ways, also those on which what is lifted first goes nowhere else."""
        ways = [self._around(plan, caught, posture, up) for up in (0.0, _STRAIGHT_UP)]
        return np.concatenate(ways)

    def _around(self, plan: Array, caught: Mask, posture: Array, up: float) -> Array:
        fingers, hand = np.append(caught, False)[self._servos.finger], self._servos.finger < 0
        ways = []
        for lifted in (fingers, fingers | hand, np.ones_like(hand)):
            way = plan.copy()
            way[: round(up / self._dt), lifted] = posture[lifted]
            lift = self._servos.lift * lifted
            ways += [way + self._lift(lift, seconds, len(way)) for seconds in _DETOURS]
        return self._servos.clip(np.array(ways))

    def _lift(self, lift: Array, seconds: float, horizon: int) -> Array:
        """(H, A) what is added to the controls for so long; `lift` is (A,)."""
        return lift * (np.arange(horizon)[:, None] < steps_in(seconds, self._dt))
