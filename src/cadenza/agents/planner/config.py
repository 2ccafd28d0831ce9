"""Options of the planners. Imports nothing heavy: the command line shows them."""

from dataclasses import dataclass
from typing import Literal

ENOUGH = 8.0
"""Effort of practice beyond which little is gained. It takes about 25 times as long as the music on
one core, and half of that on two."""


PLANNING_TIMESTEPS = 1e-4, 0.1
"""Minimum and maximum [s], which keep rollouts short and the simulation stable."""

MAX_EFFORT = 1e6


@dataclass(frozen=True)
class PredictiveSamplingConfig:
    """Predictive sampling. The defaults are the paper's, except for its budget."""

    num_candidates: int = 10
    """Candidate plans per iteration, including the best one so far."""
    sigma: float = 0.05
    """Standard deviation of the noise on the knots [rad; of forearms m]."""
    num_knots: int = 2
    """Knots of the cubic spline that parametrises a plan."""
    horizon: float = 0.2
    """Planning horizon [s]."""
    planning_timestep: float = 0.01
    """Physics timestep of a rollout [s], after each of which the cost is evaluated."""
    iterations: int = 1
    """Iterations of sampling per control step."""
    budget: float | None = None
    """Plan for this long instead, as a multiple of the duration of the music: 1 is real time, 10
    the paper's. The actions then depend on how fast the machine is, not on the seed alone."""


@dataclass(frozen=True)
class ILQGConfig:
    """iLQG, the derivative-based planner. The defaults are the paper's where it states any."""

    horizon: float = 0.2
    """Planning horizon [s]: a whole number of control steps."""
    planning_timestep: float = 0.01
    """Physics timestep of a plan [s], after each of which the cost is evaluated. It must divide the
    control timestep."""
    iterations: int = 1
    """Iterations of optimisation per control step."""
    num_step_sizes: int = 10
    """Step sizes in the line search, spaced logarithmically from 1 to 0.001."""
    control_weight: float = 1e-2
    """Weight of the squared control cost. Controls count from rest, in half ranges."""
    centred: bool = False
    """Use centred finite differences. They take twice as long as forward differences."""


Refinement = Literal["predictive-sampling", "none"]


@dataclass(frozen=True)
class PlannerConfig:
    """The planner: inverse kinematics of the song, refined by sampling."""

    fingering: Literal["found", "score"] = "found"
    """Fingering to plan with. found: one that suits these hands. score: that of the score, where it
    has any."""
    method: Refinement = "predictive-sampling"
    """How the plan is refined. With none, the plan is executed with feedback only."""
    num_candidates: int = 6
    """Random candidate plans per hand and iteration, where the plan makes mistakes. Some others are
    tried as well."""
    iterations: int = 3
    """Maximum iterations of sampling per control step. It stops when a plan makes no mistake."""
    horizon: float = 0.35
    """Planning horizon [s]."""
    proposals: Literal["learnt", "none"] = "learnt"
    """learnt: a search begins with the controls of networks, where there are some for these
    hands."""
    effort: float = 0.0
    """Effort of practice before playing: 1 is 100 simulated control steps for each control step of
    the song and each hand. With 0, it plays without practice."""


@dataclass(frozen=True)
class ICPConfig:
    """Offline planning: all of the song before the first action, and feedback of joints alone."""

    fingers: Literal["nearest", "found"] = "nearest"
    """nearest: the fingertips that come nearest to the keys of each chord. found: those that the
    search finds for the whole song."""
    rehearse: bool = True
    """Rehearse the plan in simulation first, each hand by itself, refined by the planner's
    sampling. Otherwise it is played as inverse kinematics made it."""
