"""What can be chosen about the planners. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


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


@dataclass(frozen=True)
class ILQGConfig:
    """iLQG, the planner with derivatives; the defaults are the paper's where it has any."""

    horizon: float = 0.2
    """How far a plan looks ahead [s]; a whole number of control steps."""
    planning_timestep: float = 0.01
    """How often its cost is counted [s]; a control step holds a whole number of them."""
    iterations: int = 1
    """How many times a control step improves the plan."""
    num_step_sizes: int = 10
    """Step sizes compared at a time, spaced evenly on a logarithmic scale from 1 to 0.001."""
    control_weight: float = 1e-2
    """Weight of the squared distance of servos from rest, in half ranges."""
    centred: bool = False
    """Centred finite differences, which take twice the time of forward ones."""


SamplingMethod = Literal["predictive-sampling", "cross-entropy", "mppi"]


@dataclass(frozen=True)
class ScorePlannerConfig:
    """Inverse kinematics of the whole song, refined by sampling around it."""

    fingering: Literal["found", "score"] = "found"
    """Which fingers play: those that suit these hands, or as far as it says those of the score."""
    method: SamplingMethod | Literal["none"] = "predictive-sampling"
    """How the plan is refined; with none, it is played as it is, with feedback."""
    num_candidates: int = 16
    """Plans compared at a time, for each hand, where what is planned goes wrong."""
    iterations: int = 3
    """How many times they are drawn and compared at most, until one makes no mistake."""
    horizon: float = 0.35
    """How far a plan looks ahead [s]."""


@dataclass(frozen=True)
class TrackedPressesConfig:
    """Trajectory optimisation of the presses beforehand, tracked by time-varying LQR."""

    iterations: int = 4
    """How many times the controls around a press are improved at most, until no key is wrong."""
