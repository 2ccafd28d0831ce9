"""Options that several commands share: who plays what, in which task and scene."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, dataclass, field, fields, make_dataclass, replace
from keyword import iskeyword
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import tyro

from cadenza.agents.registry import AGENTS, agent_options, options_name
from cadenza.cli.arguments import Advanced, Chosen, parse
from cadenza.cli.progress import stages
from cadenza.errors import CadenzaError
from cadenza.hub import is_on_hub
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig, with_time_to_begin
from cadenza.tasks.setups import NamedSetup, setup_named

if TYPE_CHECKING:
    from cadenza.performing.setup import Selection, Setup

Command = TypeVar("Command", bound="Options")
Read = Callable[..., Command]
"""Reads the command line, with these defaults for fields of the command, by name."""

TRAIN = "train:"  # what the name of an agent begins with that is trained first

AGENTS_HELP = (
    'Who plays: a name from "cadenza info", the folder of a policy, hub:OWNER/NAME, or '
    "module:Class. By default the planner, or the policy whose folder is SONG."
)
SETUP_HELP = 'Options by one name, such as allegro, see "cadenza info". Others override it.'


@dataclass(frozen=True)
class Options:
    """Options of all commands that have agents play."""

    arrangement: tyro.conf.OmitArgPrefixes[Arrangement] = field(default_factory=Arrangement)
    setup: Annotated[str | None, tyro.conf.arg(help=SETUP_HELP)] = None
    task: tyro.conf.OmitArgPrefixes[TaskConfig] = field(default_factory=with_time_to_begin)
    scene: tyro.conf.OmitArgPrefixes[SceneConfig] = field(default_factory=SceneConfig)
    num_threads: Advanced[int | None] = None
    """Threads of a planner, two by default: one for each hand."""

    agents_with_options: ClassVar[Sequence[str]] = [n for n, e in AGENTS.own.items() if e.config]
    """Our agents whose options the command has."""
    refused: ClassVar[Sequence[str]] = ()
    """Names of options that help does not list, since the command says why it takes none."""
    options: ClassVar[Mapping[str, str]] = {}
    """Agent -> the field that holds its options, see `with_options_of_agents`."""

    @property
    def configs(self) -> dict[str, Any]:
        """Agent -> its options."""
        return {agent: getattr(self, field) for agent, field in self.options.items()}


@dataclass(frozen=True)
class Performing(Options):
    """Options of the commands that perform one song."""

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")] = field(kw_only=True)
    """A song by its name (see "cadenza songs"), a MIDI or MusicXML file, or the folder of a policy
    or of a practised song."""
    learner: Advanced[str | None] = None
    """Learner of a policy, if it was given as module:NAME."""


@dataclass(frozen=True, kw_only=True)
class RecordedParts:
    """Options that import the modules with which episodes were recorded; files import none."""

    hand: Advanced[str | None] = None
    """Import a hand of your own, module:NAME, with which the episodes were recorded."""
    keyboard: Advanced[str | None] = None
    """Import a keyboard of your own, module:NAME, with which they were recorded."""


def reader(kind: type[Command], prog: str, words: Sequence[str], chosen: Chosen) -> Read[Command]:
    """Returns a function that reads the command line over defaults and the chosen setup.

    Raises:
        CadenzaError: there is no such setup or agent, or the options of an agent are called like
            something else.
    """
    setup = NamedSetup() if chosen.setup is None else setup_named(chosen.setup)
    players = chosen.agent, setup.agent, *split_agents(chosen.agents)
    kind = with_options_of_agents(kind, [name for name in players if name is not None])
    required = {
        each.name: tyro.MISSING_NONPROP
        for each in fields(kind)
        if each.default is each.default_factory is MISSING
    }

    def read(**defaults: Any) -> Command:
        usual = replace(kind(**required), **defaults)
        return parse(kind, prog, words, _with_setup(usual, setup), chosen)

    return read


def _with_setup(command: Command, setup: NamedSetup) -> Command:
    """Returns the command with the options and the agent of `setup` in place of its own."""
    player: dict[str, Any] = (
        {} if setup.agent is None else {"agent": setup.agent, "agents": (setup.agent,)}
    )
    named = {each.name: player[each.name] for each in fields(command) if each.name in player}
    return replace(setup.applied_to(command), **named)


def with_options_of_agents(kind: type[Command], named: Sequence[str] = ()) -> type[Command]:
    """Returns `kind` with a field for the options of each of our agents, and of those `named`.

    Raises:
        CadenzaError: there is no such agent, or its options are called like something else.
    """
    agents = {options_name(agent): agent for agent in kind.agents_with_options}
    taken = {*dir(kind), *(each.name for each in fields(kind))}
    for agent in dict.fromkeys(named):
        policy = os.path.isdir(agent) or is_on_hub(agent)
        if policy or agent.startswith(TRAIN) or agent_options(agent) is None:
            continue
        name = options_name(agent)
        if name in taken or not name.isidentifier() or iskeyword(name):
            option = name.replace("_", "-")
            raise CadenzaError(
                f"agent {agent}: its options cannot be called --{option}, as something else is or "
                "as that is no name; give the agent another one"
            )
        agents[name] = agent
        taken.add(name)
    configs: dict[str, Any] = {name: agent_options(agent) for name, agent in agents.items()}
    return make_dataclass(
        kind.__name__,
        [(name, config, field(default_factory=config)) for name, config in configs.items()],
        bases=(kind,),
        namespace={
            "__doc__": kind.__doc__,
            "options": {agent: name for name, agent in agents.items()},
        },
        frozen=True,
    )


def split_agents(words: Sequence[str]) -> list[str]:
    """Returns the agents in words such as "planner,zero"; a policy's folder may have commas."""
    return [
        name
        for word in words
        for name in ([word] if os.path.isdir(word) else word.split(","))
        if name
    ]


def check_all_play(command: Options, agents: Collection[str]) -> None:
    """Checks that the command gives options of those `agents` only that play.

    Raises:
        CadenzaError: it gives an option of another one.
    """
    for agent, config in command.configs.items():
        usual = type(config)()
        given = [
            f.name for f in fields(config) if getattr(config, f.name) != getattr(usual, f.name)
        ]
        if given and agent not in agents:
            option = f"{command.options[agent]}.{given[0]}".replace("_", "-")
            raise CadenzaError(f"--{option}: {agent} does not play; leave it out, or have it play")


@contextmanager
def setting_up(selection: Selection, command: Options, seed: int = 0) -> Iterator[Setup]:
    """`set_up` with the command's task and scene; shows how far the search for fingers is."""
    from cadenza.performing.setup import set_up

    with ExitStack() as kept:
        with stages("playing") as progress:
            setup = kept.enter_context(
                set_up(
                    selection.with_options(command.task, command.scene, seed, command.num_threads),
                    progress,
                )
            )
        yield setup
