"""Agents of one environment, as in version 0.2, for one version more.

They had `reset(task, rng)` and `act()`, and may have been written around one of ours.
"""

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
        _warn(agent)

    def reset(self, env_ids: Sequence[int], rngs: Sequence[np.random.Generator]) -> None:
        if hasattr(self._agent, "progress"):
            self._agent.progress = self.progress
        (rng,) = rngs
        self._agent.reset(self._task, rng)

    def act(self, view: View) -> Array:
        return np.asarray(self._agent.act(), np.float64)[None]


def also_of_one(agent: Agent) -> Agent:
    """`agent`, which others may call as before, too."""
    reset, act = agent.reset, agent.act
    task: PianoTask | None = None

    def reset_either(env_ids: Any, rngs: Any) -> None:
        nonlocal task
        task = env_ids if isinstance(env_ids, PianoTask) else None
        if task is None:
            reset(env_ids, rngs)
        else:
            _warn(agent)
            reset([0], [rngs])

    def act_either(view: View | None = None) -> Array:
        if task is not None:
            return act(task.view())[0]
        assert view is not None
        return act(view)

    agent.reset, agent.act = reset_either, act_either  # type: ignore[method-assign]
    return agent


def _warn(agent: Any) -> None:
    warnings.warn(
        f"agent {type(agent).__name__}: reset(task, rng) and act() will not be supported by the "
        "next version; use reset(env_ids, rngs) and act(view), see docs/how-to/agent.md",
        CadenzaWarning,
        stacklevel=4,
    )
