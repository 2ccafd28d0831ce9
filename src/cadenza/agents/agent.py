"""The interface of agents, and the two simplest agents."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.sim.threads import default_threads
from cadenza.tasks.view import View

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Ids = NDArray[np.intp]

Progress = Callable[[str, int, int], None]
"""Receives the progress of long work: stage, such as "playing", amount done, and total."""


def silent(stage: str, done: int, total: int) -> None:
    """Ignore progress."""


def steps_in(seconds: float, dt: float) -> int:
    """Number of control steps of `dt` [s] nearest to `seconds`, at least one."""
    return max(1, round(seconds / dt))


class Agent(ABC):
    """An agent, which chooses the actions of N environments at once.

    Attributes:
        config: the agent's options, a dataclass that recordings keep; None without any.
        keeps_fingering: whether the agent plays with the fingers that a score gives. Demonstrations
            of other agents are recorded of the score without them.
        num_threads: the number of threads that the agent may use; None for two, one for each hand.
        progress: the receiver of the progress of long work. Callers set this and `num_threads`
            before the reset.
    """

    config: Any = None
    keeps_fingering: bool = False
    num_threads: int | None = None
    progress: Progress = staticmethod(silent)

    @property
    def threads(self) -> int:
        """Number of threads that the agent uses."""
        return self.num_threads or default_threads()

    def reset(  # noqa: B027 - some agents need none
        self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]
    ) -> None:
        """Begin an episode in each environment, with a generator for each.

        The next view is of step 0.
        """

    @abstractmethod
    def act(self, view: View) -> Array:
        """Next actions (N, A) in actuator units, the pedal last.

        Rows of environments that are not `view.playing` are ignored.
        """

    def song_plan(self, env_id: int) -> Any:
        """`SongPlan` that an environment's episode follows, None for an agent without one.

        Reports show its fingers, and explain missed notes by it.
        """
        return None

    def close(self) -> None:  # noqa: B027 - as above
        """Free resources of the episodes, such as threads. A reset may follow."""


def check_planned_for(view: View, steps: int, width: int) -> None:
    """Check that a plan of `steps` actions of `width` each fits the episodes of `view`.

    Raises CadenzaError if their number or their width differs from the task's.
    """
    if width != view.task.action_size:
        flag = "no-reduced" if view.task.scene.config.reduced_action_space else "reduced"
        raise CadenzaError(
            f"the plan has {width} actions per step, but this task has {view.task.action_size}: "
            f"was it made for other hands or the other action space (--{flag}-action-space)?"
        )
    if len(lengths := view.num_steps[view.num_steps != steps]):
        raise CadenzaError(
            f"the plan has {steps} steps, but the song has {lengths[0]}: "
            "was it made for another song, tempo or initial silence?"
        )


class EpisodePlanner(ABC):
    """A planner of one episode of one environment.

    Attributes:
        plan: the `SongPlan` that it follows, see `Agent.song_plan`; None without one.
    """

    plan: Any = None

    @abstractmethod
    def act(self, view: View) -> Array:
        """Next action (A,); `view` has this environment alone."""


P = TypeVar("P", bound=EpisodePlanner)


class PlannerPerEnv(Agent, Generic[P]):
    """An agent with a planner of its own for the episode of every environment.

    Attributes:
        planners: environment -> the planner of its episode, from the first step on.
    """

    def __init__(self) -> None:
        self.planners: dict[int, P] = {}
        self._rngs: dict[int, np.random.Generator] = {}

    @abstractmethod
    def begin(self, view: View, rng: np.random.Generator) -> P:
        """Planner of the episode that begins in the only environment of `view`.

        Raises CadenzaError if the agent cannot play this task.
        """

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

    def song_plan(self, env_id: int) -> Any:
        planner = self.planners.get(env_id)
        return None if planner is None else planner.plan

    def close(self) -> None:
        self.planners.clear()


class ZeroAgent(Agent):
    """An agent that keeps all servos at zero, where hands start by default, and the pedal up."""

    def act(self, view: View) -> Array:
        low, high = view.task.action_low, view.task.action_high
        return np.clip(np.zeros((len(view.env_ids), len(low))), low, high)


class RandomAgent(Agent):
    """An agent that draws every action uniformly from the actuators' ranges."""

    def __init__(self) -> None:
        self._rngs: dict[int, np.random.Generator] = {}

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        self._rngs |= dict(zip(env_ids, rngs, strict=True))

    def act(self, view: View) -> Array:
        low, high = view.task.action_low, view.task.action_high
        return np.array([self._rngs[env].uniform(low, high) for env in view.env_ids.tolist()])
