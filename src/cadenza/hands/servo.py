"""A servo as planners and residual policies use it."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Servo:
    """A servo as inverse kinematics, sampling and learning see it; in its own units [m, rad]."""

    rest: float = 0.0
    """Its position while its hand is at ease over the keys."""
    ease: float = 0.5
    """Scale of its distance from rest: the distance that costs 1."""
    acceleration: float = 160.0
    """Scale of its acceleration: the acceleration that costs 1 [m/s^2, rad/s^2]."""
    stride: float = 0.4
    """Largest step of an iteration of inverse kinematics."""
    noise: float = 0.08
    """Standard deviation of the candidates that a planner samples around its plan."""
    travel: float = math.inf
    """Largest distance from rest to which a policy without a plan moves it."""
    correction: float = 0.25
    """Largest correction by a residual policy."""
    lift: float = 0.0
    """Motion that frees a hand caught between keys, if it is added for a moment."""
    finger: int | None = None
    """Index of the finger that it moves, 0 for the thumb; None if it moves the whole hand."""
