"""How what a policy does becomes the actions of a task."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.learning.observation import Floats
from cadenza.learning.ranges import Ranges
from cadenza.learning.residual import Reference, ReferenceTracker
from cadenza.tasks.piano_task import PianoTask


class Control(NamedTuple):
    """What a policy does is in [-1, 1]."""

    ctrl: Callable[[Floats], NDArray[np.float64]]
    """From what it does (N, A) to actions in actuator units."""
    reference: Floats | None
    """(T, A) what is done if it does nothing, in [-1, 1], where it corrects that."""


def control_of(task: PianoTask, reference: Reference | None, ranges: Ranges | None) -> Control:
    """A policy corrects a reference, or else acts within `ranges`, or within those of the task."""
    if reference is not None:
        tracker = ReferenceTracker(task, reference)
        return Control(tracker.ctrl, tracker.actions)
    return Control(ranges.ctrl if ranges else task.scale_action, None)
