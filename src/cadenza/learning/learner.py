"""Learners by protocol and by name. Imports nothing heavy, for --help.

A learner is named by its configuration, a frozen dataclass that makes it. Another package adds one
by an entry point of the group `cadenza.learners`.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol, Self, TypeVar

from cadenza.configs import check_ranges
from cadenza.errors import CadenzaError, extra_packages
from cadenza.registry import Entry, Registry, module_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cadenza.learning.env_rollout import Decision, EnvRollout
    from cadenza.learning.observation import Inputs
    from cadenza.learning.policy import Policy
    from cadenza.learning.replay_buffer import Batch

State = TypeVar("State")
Preset = Literal["fast", "paper", "published"]
Ends = tuple[tuple[int, int], ...]
"""Pairs of updates: the one at which an end of the run was set, at first 0, and that end."""

DROQ = "droq"
PPO = "ppo"
LEARNERS = Registry(
    "learner",
    "cadenza.learners",
    {
        DROQ: Entry(
            "cadenza.learning.algorithms.droq.config:DroQConfig",
            "soft actor-critic with dropout in the critics",
        ),
        PPO: Entry(
            "cadenza.learning.algorithms.ppo.config:PPOConfig",
            "proximal policy optimisation, for many environments at once",
        ),
    },
)


class AnyLearner(Protocol[State]):
    """Improve a policy.

    All that learning changes is in a state, so that a run can be stopped and resumed.
    """

    num_threads: int | None  # the number of threads, if the last digits of the results depend on it

    def init(self, seed: int) -> State:
        """Draw the state before the first update."""

    def policy(self, state: State) -> Policy:
        """The policy that is evaluated and saved."""

    def behavior_policy(self, state: State) -> Policy:
        """The policy that collects experience, by its samples."""

    def to_arrays(self, state: State) -> dict[str, NDArray[Any]]:
        """A state as arrays by name, for `from_arrays`."""

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> State:
        """The state of `to_arrays`; raises CadenzaError if the arrays are another learner's."""


class Learner(AnyLearner[State], Protocol[State]):
    """Improve a policy by batches of transitions, whichever policy they come from."""

    def update(self, state: State, batches: Batch) -> tuple[State, dict[str, NDArray[Any]]]:
        """Make one update for each of the batches (U, B, ...); `state` may be used up.

        Returns the new state, and by name metrics (U,) of each update, NaN where an update has
        none.
        """


class OnPolicyLearner(AnyLearner[State], Protocol[State]):
    """Improve a policy by rollouts of that policy; its arrays are those of JAX."""

    def act(self, state: State, observation: Any, key: Any) -> Decision:
        """Draw actions for observations (N, D) by `key`; JAX can compile it."""

    def value(self, state: State, observation: Any) -> Any:
        """The values (N,) of observations (N, D); see `act`."""

    def update(
        self, state: State, rollout: EnvRollout, rows: Any
    ) -> tuple[State, dict[str, NDArray[Any]]]:
        """Make one update for each of `rows` (U, B) of the T * N transitions of a rollout.

        Transitions are ordered by step, then by environment. `state` may be used up. Returns as
        `Learner.update`.
        """


MAX_BATCH = 2**16  # transitions, which fit into the memory of a small machine


@dataclass(frozen=True)
class LearnerConfig:
    """Options that all learners have. A learner's own configuration adds others, and makes it."""

    learner: ClassVar[str] = ""
    """The place of the learner as `module:Name`, which is imported when it is made: help shows the
    options without it."""
    on_policy: ClassVar[bool] = False
    """Whether it makes an `OnPolicyLearner`."""
    training: ClassVar[Mapping[str, Any]] = {}
    """What presets change for this learner: fields of `TrainingConfig`."""
    batch_size: int = 256
    """Transitions per update."""

    @classmethod
    def preset(cls, name: Preset, residual: bool) -> Self:  # noqa: ARG003
        """The options of a preset; by default the same for all."""
        return cls()

    def check(self) -> None:
        """Check the options; raises a CadenzaError if one makes no sense."""
        check_ranges(self, {"batch_size": (1, MAX_BATCH)})

    def make(self, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)) -> Any:
        """The `Learner` that these options describe, or the `OnPolicyLearner`.

        Its policy observes `inputs`, and has A = `action_size` actions in [-1, 1]; schedules follow
        the `ends` of the run. Raises CadenzaError if a library that it needs is missing.
        """
        if not self.learner:
            raise NotImplementedError(f"{type(self).__name__} makes no learner")
        module, _, name = self.learner.partition(":")
        with extra_packages("train", "training"):
            learner = getattr(importlib.import_module(module), name)
        return learner(self, inputs, action_size, ends)

    @classmethod
    def policy_of(cls, facts: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Policy:
        """The policy of a `state` that is no `Perceptron`; raises CadenzaError without one."""
        raise NotImplementedError(f"{cls.__name__} reads no policy")


def check_hidden_sizes(sizes: tuple[int, ...]) -> None:
    """Raise a CadenzaError if there is no hidden layer, or one without a unit."""
    if not sizes or min(sizes) < 1:
        raise CadenzaError(f"hidden_sizes {sizes}: give one width per layer")


def learner_config(name: str) -> type[LearnerConfig]:
    """The configuration of the learner of this name.

    Raises CadenzaError if there is none, or the module of a name `module:Name` is not imported: a
    name may come from a file, which must not make Cadenza run a module.
    """
    if (module := module_of(name)) is not None and module not in sys.modules:
        raise CadenzaError(
            f"learner {name}: no file makes Cadenza import a module; give --learner {name} if you "
            f"trust it, or import {module} first"
        )
    kind = LEARNERS.load(name, type)
    if not issubclass(kind, LearnerConfig):
        raise CadenzaError(f"learner {name}: {kind.__name__} is no LearnerConfig of cadenza")
    return kind


def name_of(config: LearnerConfig) -> str:
    """The name by which `learner_config` finds a class; raises CadenzaError if others could not."""
    kind = type(config)
    place = f"{kind.__module__}:{kind.__qualname__}"
    for name, entry in LEARNERS.entries().items():
        if entry.place == place:
            return name
    if kind.__module__ == "__main__" or "<locals>" in place:
        raise CadenzaError(
            f"learner {place}: its run could not be resumed; put the class into a module of its own"
        )
    return place
