"""What can be chosen about the planners. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PredictiveSamplingConfig:
    """Predictive sampling; the defaults are the paper's settings."""

    num_candidates: int = 10
    """Plans compared at a time, the last best one always among them."""
    sigma: float = 0.05
    """Standard deviation of the knots, in units of half the control range."""
    num_knots: int = 2
    """Knots of the cubic spline that a plan is."""
    horizon: float = 0.2
    """How far a plan looks ahead [s]."""
    planning_timestep: float = 0.01
    """How often its cost is counted [s]."""
    iterations: int = 1
    """How many times a control step draws and compares plans."""
