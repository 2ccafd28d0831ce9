"""Agents written for version 0.2, for one version more: `reset(task, rng)` and `act()`."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Protocol, cast

import numpy as np

from cadenza.agents.agent import Agent, Array
from cadenza.errors import CadenzaWarning
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import View


class AgentOfOneEnvironment(Protocol):
    """What an agent had to be."""

    def reset(self, task: PianoTask, rng: np.random.Generator) -> None: ...
    def act(self) -> Array: ...


def of_many(agent: Agent | AgentOfOneEnvironment, task: PianoTask) -> Agent:
    """`agent` as one for any number of environments; those of `task` where it needs one itself."""
    if _takes_no_view(agent.act):
        return OneEnvironment(cast(AgentOfOneEnvironment, agent), task)
    return cast(Agent, agent)


def _takes_no_view(act: Callable[..., Any]) -> bool:
    try:
        return not inspect.signature(act).parameters
    except ValueError:  # not written in Python
        return False


class OneEnvironment(Agent):
    """Plays a task of one environment with such an agent."""

    def __init__(self, agent: AgentOfOneEnvironment, task: PianoTask) -> None:
        self._agent, self._task = agent, task
        warnings.warn(
            f"agent {type(agent).__name__}: reset(task, rng) and act() will not be supported by "
            "the next version; write reset(env_ids, rngs) and act(view), see docs/python.md",
            CadenzaWarning,
            stacklevel=4,
        )

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        if hasattr(self._agent, "progress"):
            self._agent.progress = self.progress
        (rng,) = rngs
        self._agent.reset(self._task, rng)

    def act(self, view: View) -> Array:
        return np.asarray(self._agent.act(), np.float64)[None]
