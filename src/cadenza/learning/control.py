"""How what a policy does becomes the actions of a task."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from cadenza.learning.observation import Floats
from cadenza.learning.ranges import Ranges
from cadenza.learning.residual import Reference, ReferenceTracker
from cadenza.sim.protocol import State
from cadenza.tasks.view import TaskSpec


class ToActions(Protocol):
    """Makes actions of what a policy does."""

    def __call__(
        self, action: Floats, steps: NDArray[np.intp], state: State, /
    ) -> NDArray[np.float64]:
        """(N, A) in actuator units, the pedal last.

        Args:
            action: (N, A) what it does, in [-1, 1].
            steps: (N,) of the song, that are played next.
            state: of N simulations.
        """


class Control(NamedTuple):
    """What a policy does is in [-1, 1]."""

    ctrl: ToActions
    reference: Floats | None
    """(T, A) what is done if it does nothing, in [-1, 1], where it corrects that."""


def control_of(task: TaskSpec, reference: Reference | None, ranges: Ranges | None) -> Control:
    """A policy corrects a reference, or else acts within `ranges`, or within those of the task."""
    if reference is not None:
        tracker = ReferenceTracker(task, reference)
        return Control(tracker.ctrl, tracker.actions)
    scale = ranges.ctrl if ranges else task.scale_action
    return Control(lambda action, _steps, _state: scale(action), None)
