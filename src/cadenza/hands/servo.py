"""The parameters of servos for planners and residual policies."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Servo:
    """The parameters of a servo in inverse kinematics, sampling and learning, in [m, rad]."""

    rest: float = 0.0
    """The position at which the hand is at ease over the keys."""
    ease: float = 0.5
    """The distance from rest that costs 1."""
    acceleration: float = 160.0
    """The acceleration that costs 1 [m/s^2, rad/s^2]."""
    stride: float = 0.4
    """Largest step of an iteration of inverse kinematics."""
    noise: float = 0.08
    """Standard deviation of the candidates that a planner samples around its plan."""
    travel: float = math.inf
    """Largest distance from rest to which a policy without a plan moves it."""
    correction: float = 0.25
    """Largest correction by the generalist's networks."""
    lift: float = 0.0
    """Motion that frees a hand caught between keys, if it is added for a moment."""
    finger: int | None = None
    """Index of the finger that it moves, 0 for the thumb; None if it moves the whole hand."""
