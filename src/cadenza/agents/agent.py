"""What an agent is, and the two simplest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cadenza.tasks.piano_task import PianoTask

Array = NDArray[np.float64]

Progress = Callable[[str, int, int], None]
"""Is told a stage of long work, such as "playing", how much of it is done, and how much it is."""


def silent(stage: str, done: int, total: int) -> None:
    """Tells nobody."""


class Agent(Protocol):
    """Chooses the actions of a task with one environment."""

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        """An episode of `task` begins; all that is random comes from `rng`."""

    def act(self) -> Array:
        """(A,) the next action in actuator units, the pedal last."""


@runtime_checkable
class ReportingAgent(Agent, Protocol):
    """One that thinks for long, in `reset` or in `act`, and says how far it has come.

    `cadenza.agents.rollout` puts its own `progress` there before it resets the agent.
    """

    progress: Progress


class ZeroAgent:
    """Leaves all servos at zero, as the hands start unless that is drawn, and the pedal up."""

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        start = np.zeros(task.action_size)
        self._action = np.clip(start, task.action_low, task.action_high)

    def act(self) -> Array:
        return self._action


class RandomAgent:
    """Draws every action anew, uniformly over the actuators' ranges."""

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None:
        self._low, self._high, self._rng = task.action_low, task.action_high, rng

    def act(self) -> Array:
        return self._rng.uniform(self._low, self._high)
