"""How planners and residual policies use a servo."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Servo:
    """A servo as inverse kinematics, sampling and learning see it; in its own units [m, rad]."""

    rest: float = 0.0
    """Where it is while its hand is at ease over the keys."""
    ease: float = 0.5
    """How far from rest counts as one."""
    acceleration: float = 160.0
    """Which acceleration counts as one [m/s^2, rad/s^2]."""
    stride: float = 0.4
    """The most that an iteration of inverse kinematics moves it."""
    noise: float = 0.08
    """Standard deviation of the candidates that a planner tries around its plan."""
    travel: float = math.inf
    """The most that a policy without a plan moves it from rest."""
    correction: float = 0.25
    """The most that a residual policy corrects it."""
    lift: float = 0.0
    """What frees a hand that is caught between keys, if it is added for a moment."""
    finger: int | None = None
    """The finger that it moves, 0 for the thumb; None if it moves the whole hand."""
