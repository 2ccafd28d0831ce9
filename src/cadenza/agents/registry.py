"""The names of agents. Imports nothing heavy: the command line shows them.

Policies and practised songs are folders, see `cadenza.performing.setup`.
"""

from __future__ import annotations

import inspect
import os
import re
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from cadenza.agents.generalist.config import GeneralistConfig
from cadenza.agents.planner.config import (
    ICPConfig,
    ILQGConfig,
    PlannerConfig,
    PredictiveSamplingConfig,
)
from cadenza.configs import as_config, check_kind
from cadenza.errors import CadenzaError, by_others, quoted
from cadenza.files import TENSORS
from cadenza.hub import is_on_hub
from cadenza.registry import Entry, Registry

if TYPE_CHECKING:
    from cadenza.agents.agent import Agent

PLANNER, PRETRAINED, PLAYBACK = "planner", "pretrained", "playback"
PRACTISED = f"plan{TENSORS}"  # the plan in the folder of a practised song

_BASELINES = "cadenza.agents.baselines"
AGENTS = Registry(
    "agent",
    "cadenza.agents",
    {
        PLANNER: Entry(
            "cadenza.agents.planner.planner:Planner",
            "inverse kinematics of the song, refined by sampling",
            PlannerConfig,
        ),
        "generalist": Entry(
            "cadenza.agents.generalist.generalist:Generalist",
            "a plan of the song, or of what is in sight, corrected by networks",
            GeneralistConfig,
        ),
        "predictive-sampling": Entry(
            f"{_BASELINES}.predictive_sampling:PredictiveSampling",
            "the paper's planner without derivatives",
            PredictiveSamplingConfig,
        ),
        "ilqg": Entry(
            f"{_BASELINES}.ilqg:ILQG", "the paper's planner with derivatives", ILQGConfig
        ),
        "stitched": Entry(
            f"{_BASELINES}.stitched:Stitched",
            "motions that are planned once, stitched together, and played open loop",
        ),
        "icp": Entry(
            f"{_BASELINES}.icp:ICP",
            "nearest fingers by iterative closest point (ICP), inverse kinematics, all offline",
            ICPConfig,
        ),
        "zero": Entry("cadenza.agents.agent:ZeroAgent", "hands that stay where they are"),
        "random": Entry("cadenza.agents.agent:RandomAgent", "uniformly random actions"),
        PRETRAINED: Entry(
            "cadenza.learning.learnt_policy:PolicyAgent", "the policy that comes with the song"
        ),
        PLAYBACK: Entry("cadenza.agents.playback:Playback", "the actions of a plan"),
    },
    otherwise="the folder of a policy or module:Class",
)


def is_folder(agent: str) -> bool:
    """Whether an agent is a folder, of a policy or of practice, here or on the hub."""
    return agent not in AGENTS.own and (os.path.isdir(agent) or is_on_hub(agent))


def make_agent(name: str, config: Any = None) -> Agent:
    """An agent that plays any task, by a name of `AGENTS` or as `module:Class`.

    Its `config` is of the type that `agent_options` returns. Raises CadenzaError if there is no
    such agent, its class is not derived from `cadenza.Agent`, or an option makes no sense.
    """
    if not isinstance(name, str):
        raise CadenzaError(f"agent {quoted(name)}: give its name, such as {PLANNER!r}")
    if name in (PRETRAINED, PLAYBACK):
        raise CadenzaError(f"agent {quoted(name)} depends on the song: pass it to cadenza.play")
    kind: Any = AGENTS.load(name, type)
    options = agent_options(name)
    if options is None and config is not None:
        raise CadenzaError(f"agent {quoted(name)} has no options: give none")
    with by_others(f"agent {name}"):
        if options is None:
            return checked_agent(kind(), name)
        config = as_config(config, options)
        agent = checked_agent(kind(config), name)
        agent.config = config  # its class may not keep it
        return agent


def agent_options(name: str) -> type | None:
    """The dataclass of an agent's options, None if it has none.

    It is the type of the parameter `config` of the agent's class. Raises CadenzaError if there is
    no such agent, or a field of its options is of no allowed type.
    """
    if (entry := AGENTS.own.get(name)) is not None:
        return entry.config
    kind: Any = AGENTS.load(name, type)
    with by_others(f"agent {name}"):
        if "config" not in inspect.signature(kind).parameters:
            return None
        hint = get_type_hints(kind.__init__).get("config")
        for candidate in (hint, *get_args(hint)):
            if isinstance(candidate, type) and is_dataclass(candidate):
                check_kind(candidate)
                return candidate
    return None


def options_name(name: str) -> str:
    """The common prefix of an agent's options: `planner`; `some_agent` for `module:SomeAgent`."""
    _, colon, last = name.rpartition(":")
    if colon:
        last = re.sub("(?<=[a-z0-9])(?=[A-Z])", "_", last.rpartition(".")[2]).lower()
    return re.sub(r"\W", "_", last)


def checked_agent(agent: Any, place: str) -> Agent:
    """Return `agent` if it is one; errors name it `place`.

    Raises CadenzaError if it is a class, or its class is not derived from `cadenza.Agent`.
    """
    from cadenza.agents.agent import Agent  # slow to import

    if isinstance(agent, type):
        raise CadenzaError(f"agent {agent.__name__}: is a class; give an instance of it")
    if not isinstance(agent, Agent):
        raise CadenzaError(f"agent {place}: is no Agent; derive its class from cadenza.Agent")
    return agent
