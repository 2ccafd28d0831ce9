"""Ways for a hand to get off what it is caught by: it, or some of its fingers, are lifted."""

from __future__ import annotations

from collections.abc import Sequence

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


_WORTH = 0.15  # that a finger has to cost less
_SEEN = 3  # steps that must have been tried for that


def combined(plans: Array, costs: Sequence[Array], best: int, finger: NDArray[np.intp]) -> Array:
    """(C, H, A) the best plan, with each finger as in the plan in which it does best by itself.

    One plan mends what one finger does, another what another does, and each is worse elsewhere. As
    the hand is where it is, fingers hardly move each other.

    There is none if no finger does much better in another plan.

    Args:
        plans: (N, H, A)
        costs: (L, F) of each, what L of its H steps have cost by finger.
        best: which has been tried to its end, and cost least.
        finger: (A,) that each servo moves, -1 for the whole hand.
    """
    so_far = np.pad(costs[best].cumsum(axis=0), ((1, 0), (0, 0)))
    better = np.array([so_far[len(cost)] - cost.sum(axis=0) for cost in costs])
    better[[len(cost) < min(_SEEN, len(costs[best])) for cost in costs]] = 0.0
    of = np.where(better.max(axis=0) > _WORTH, better.argmax(axis=0), best)
    plan = plans[np.append(of, best)[finger], :, np.arange(len(finger))].T
    return plan[None] if (of != best).any() else plans[:0]
