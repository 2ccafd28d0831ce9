"""How what a policy does becomes the actions of a task."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.learning.observation import Floats
from cadenza.learning.ranges import Ranges
from cadenza.learning.residual import Plan, PlanFollower
from cadenza.tasks.piano_task import PianoTask


class Control(NamedTuple):
    """What a policy does is in [-1, 1]."""

    ctrl: Callable[[Floats], NDArray[np.float64]]
    """From what it does (N, A) to actions in actuator units."""
    plan: Floats | None
    """(T, A) what is done if it does nothing, in [-1, 1]; None where that is not planned."""


def control_of(task: PianoTask, plan: Plan | None, ranges: Ranges | None) -> Control:
    """A policy corrects `plan`, or else acts within `ranges`, or else within those of the task."""
    if plan is not None:
        follower = PlanFollower(task, plan)
        return Control(follower.ctrl, follower.actions)
    return Control(ranges.ctrl if ranges else task.scale_action, None)
