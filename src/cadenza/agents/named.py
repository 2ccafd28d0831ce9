"""Agents by name: those that come with Cadenza, and classes of anybody's.

Imports nothing heavy: the command line shows the names. Learnt policies are folders, see
`cadenza.learning.policy_folder`.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any

from cadenza.agents.others import by_others
from cadenza.agents.planning.config import (
    ILQGConfig,
    PredictiveSamplingConfig,
    ScorePlannerConfig,
    TrackedPressesConfig,
)
from cadenza.configs import as_config
from cadenza.errors import CadenzaError

if TYPE_CHECKING:
    from cadenza.agents.agent import Agent

PLANNER, PRETRAINED, REPLAY = "planner", "pretrained", "replay"


@dataclass(frozen=True)
class NamedAgent:
    """An agent that comes with Cadenza."""

    about: str
    """Who that is, in a line."""
    place: str
    """Its class, as `module:Class`."""
    config: type | None = None
    """What its class is called with."""


_PLANNING = "cadenza.agents.planning"
_BASELINES = "cadenza.agents.baselines"
AGENTS = {
    PLANNER: NamedAgent(
        "inverse kinematics of the song, refined by sampling",
        f"{_PLANNING}.score_planner:ScorePlanner",
        ScorePlannerConfig,
    ),
    "predictive-sampling": NamedAgent(
        "the paper's planner without derivatives",
        f"{_BASELINES}.predictive_sampling:PredictiveSampling",
        PredictiveSamplingConfig,
    ),
    "ilqg": NamedAgent(
        "the paper's planner with derivatives", f"{_BASELINES}.ilqg:ILQG", ILQGConfig
    ),
    "tracked-presses": NamedAgent(
        "key presses optimised beforehand and tracked with LQR",
        f"{_BASELINES}.tracked_presses:TrackedPresses",
        TrackedPressesConfig,
    ),
    "zero": NamedAgent("hands that stay where they are", "cadenza.agents.agent:ZeroAgent"),
    "random": NamedAgent("uniformly random actions", "cadenza.agents.agent:RandomAgent"),
}
"""Name -> agent, of all that need nothing but a task."""
NAMES = (*AGENTS, PRETRAINED, REPLAY)


def make_agent(name: str, config: Any = None) -> Agent:
    """An agent that plays any task.

    Args:
        name: one of `AGENTS`, or `module:Class`, a class of your own with the methods of
            `cadenza.Agent`, which is called without arguments.
        config: the options of a planner, see `cadenza.agents.planning.config`; its defaults where
            there are none.

    Raises:
        CadenzaError: there is no such agent, it has not the methods of one, or an option makes no
            sense.
    """
    if not isinstance(name, str):
        raise CadenzaError(f"agent {name!r:.100}: give its name, such as {PLANNER!r}")
    if name in AGENTS:
        kind, options = _class_at(AGENTS[name].place), AGENTS[name].config
        if options is None and config is not None:
            raise CadenzaError(f"agent {name!r} has no options: give none")
        return kind() if options is None else kind(as_config(config, options))
    if ":" in name:
        with by_others(f"agent {name}"):
            agent = _class_at(name)()
        return checked_agent(agent, name)
    if name in NAMES:
        raise CadenzaError(f"agent {name!r} depends on the song: pass it to cadenza.play")
    close = get_close_matches(name, NAMES, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    raise CadenzaError(
        f"no agent {name!r}: {hint}choose from {', '.join(NAMES)}, or give the folder of a policy "
        "or module:Class"
    )


def _class_at(place: str) -> Any:
    module, _, name = place.partition(":")
    with by_others(f"agent {place}: cannot import {module!r}"):
        found = importlib.import_module(module)
    kind = getattr(found, name, None)
    if not isinstance(kind, type):
        raise CadenzaError(f"agent {place}: there is no class {name!r} in {module}")
    return kind


def checked_agent(agent: Any, place: str) -> Agent:
    """`agent`, which is to be one; errors name it `place`.

    Raises:
        CadenzaError: it has not the methods of one.
    """
    if isinstance(agent, type):
        raise CadenzaError(f"agent {place}: {agent.__name__} is a class; give an instance of it")
    if lacking := [name for name in ("reset", "act") if not callable(getattr(agent, name, None))]:
        raise CadenzaError(
            f"agent {place}: has no method {' and no method '.join(lacking)}; "
            "it needs reset(task, rng) and act(), see cadenza.Agent"
        )
    return agent
