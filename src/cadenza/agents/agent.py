"""What an agent is, and the two simplest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.sim.threads import default_threads
from cadenza.tasks.view import View

Array = NDArray[np.float64]

Progress = Callable[[str, int, int], None]
"""Is told a stage of long work, such as "playing", how much of it is done, and how much it is."""


def silent(stage: str, done: int, total: int) -> None:
    """Tells nobody."""


class Agent(ABC):
    """Chooses the actions of N environments at once.

    Attributes:
        num_threads: how many threads it may use, if it can use several; by default two, one for
            each hand.
        progress: is told how far its long work is, if it has any. Whoever has the agent play sets
            both before.
    """

    num_threads: int | None = None
    progress: Progress = staticmethod(silent)

    def reset(  # noqa: B027 - not all have anything to begin
        self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]
    ) -> None:
        """Episodes begin in some environments; the next view is of their first step.

        Args:
            env_ids: which.
            rngs: for each of them, where all that is random in its episode comes from.
        """

    @abstractmethod
    def act(self, view: View) -> Array:
        """(N, A) the next actions in actuator units, the pedal last.

        What it returns for environments that are not `view.playing` does not matter.
        """

    def close(self) -> None:  # noqa: B027 - nor to end
        """Lets go of what the episodes needed, such as threads. A reset may follow."""


def check_planned_for(view: View, steps: int, width: int) -> None:
    """For what plays `steps` actions of `width` each that were planned before.

    Raises:
        CadenzaError: they are not as wide as the actions or not as many as an episode has.
    """
    if width != view.task.action_size:
        flag = "no-reduced" if view.task.scene.config.reduced_action_space else "reduced"
        raise CadenzaError(
            f"the plan has {width} actions per step, but this task has {view.task.action_size}: "
            f"was it made for other hands or the other action space (--{flag}-action-space)?"
        )
    if len(others := view.num_steps[view.num_steps != steps]):
        raise CadenzaError(
            f"the plan has {steps} steps, but the song has {others[0]}: "
            "was it made for another song, tempo or initial silence?"
        )


class EpisodePlanner(Protocol):
    """Plans and plays one episode of one environment."""

    def act(self, view: View) -> Array:
        """(A,) the next action; `view` is of this environment alone."""


P = TypeVar("P", bound=EpisodePlanner)


class PlannerPerEnv(Agent, Generic[P]):
    """Has a planner of its own for every environment, each of which plays one song.

    Attributes:
        planners: environment -> what plans its episode, from its first step on.
    """

    def __init__(self) -> None:
        self.planners: dict[int, P] = {}
        self._rngs: dict[int, np.random.Generator] = {}

    @abstractmethod
    def begin(self, view: View, rng: np.random.Generator) -> P:
        """What plans the episode that begins in the only environment of `view`."""

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        for env, rng in zip(env_ids, rngs, strict=True):
            self.planners.pop(env, None)
            self._rngs[env] = rng

    def act(self, view: View) -> Array:
        action = np.zeros((len(view.env_ids), view.task.action_size))
        for row in np.flatnonzero(view.playing).tolist():
            env, alone = int(view.env_ids[row]), view.of(row)
            if env not in self.planners:
                self.planners[env] = self.begin(alone, self._rngs[env])
            action[row] = self.planners[env].act(alone)
        return action

    def close(self) -> None:
        self.planners.clear()

    @property
    def threads(self) -> int:
        """How many it uses."""
        return self.num_threads or default_threads()


class ZeroAgent(Agent):
    """Leaves all servos at zero, as the hands start unless that is drawn, and the pedal up."""

    def act(self, view: View) -> Array:
        low, high = view.task.action_low, view.task.action_high
        return np.clip(np.zeros((len(view.env_ids), len(low))), low, high)


class RandomAgent(Agent):
    """Draws every action anew, uniformly over the actuators' ranges."""

    def __init__(self) -> None:
        self._rngs: dict[int, np.random.Generator] = {}

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._rngs |= dict(zip(env_ids, rngs, strict=True))

    def act(self, view: View) -> Array:
        low, high = view.task.action_low, view.task.action_high
        return np.array([self._rngs[env].uniform(low, high) for env in view.env_ids.tolist()])
