"""Options that several commands share: agents, songs, task and scene."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import MISSING, dataclass, field, fields, make_dataclass, replace
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import tyro

from cadenza.agents.registry import PLANNER, PRACTISED, agent_options, is_folder, options_name
from cadenza.cli.arguments import Chosen, Flat, parse
from cadenza.cli.printing import stages
from cadenza.errors import CadenzaError
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.setups import NamedSetup, setup_named

if TYPE_CHECKING:
    from cadenza.performing.setup import Player, Setup

Command = TypeVar("Command", bound="Options")
Read = Callable[..., Command]
"""A function that reads the command line, with other defaults for fields of the command."""

TRAIN = "train:"  # prefix of the names of agents that are trained first

AGENTS_HELP = (
    'Who plays: a name from "cadenza info", the folder of a policy, a training run or practice, '
    "hub:OWNER/NAME, or module:Class. What has learnt or practised a song needs no SONG."
)
SONG = tyro.conf.arg(
    metavar="SONG", help='A song by its name (see "cadenza songs"), or a MIDI or MusicXML file.'
)
SETUP_HELP = 'Options by one name, such as allegro, see "cadenza info". Others override it.'


@dataclass(frozen=True)
class Options:
    """Options of all commands that have agents play."""

    arrangement: Flat[Arrangement] = field(default_factory=Arrangement)
    setup: Annotated[str | None, tyro.conf.arg(help=SETUP_HELP)] = None
    task: Flat[TaskConfig] = field(default_factory=TaskConfig)
    scene: Flat[SceneConfig] = field(default_factory=SceneConfig)
    num_threads: int | None = None
    """Threads of a planner, two by default: one for each hand."""

    options: ClassVar[Mapping[str, str]] = {}
    """Agent -> the field that holds its options, see `with_options_of`."""

    @property
    def configs(self) -> dict[str, Any]:
        """Agent -> its options."""
        return {agent: getattr(self, field) for agent, field in self.options.items()}


@dataclass(frozen=True, kw_only=True)
class RecordedParts:
    """Options that import the modules with which episodes were recorded; files import none."""

    hand: str | None = None
    """Import a hand of your own, module:NAME, with which the episodes were recorded."""
    keyboard: str | None = None
    """Import a keyboard of your own, module:NAME, with which they were recorded."""


def reader(kind: type[Command], prog: str, words: Sequence[str], chosen: Chosen) -> Read[Command]:
    """A function that reads the command line over defaults and the chosen setup.

    The command has the options of agents that play; options of other agents are unknown. Raises
    CadenzaError if there is no such setup or agent, or the options of an agent have a taken name.
    """
    setup = NamedSetup() if chosen.setup is None else setup_named(chosen.setup)
    usual: dict[str, Any] = {each.name: each.default for each in fields(kind)}
    own: dict[str, Any] = {}  # the setup's agent
    playing: Sequence[str] = (PLANNER,)
    if "agents" in usual:
        own = {} if setup.agent is None else {"agents": (setup.agent,)}
        playing = split_agents(chosen.agents or own.get("agents", usual["agents"]))
    elif "agent" in usual:
        own = {} if setup.agent is None else {"agent": setup.agent}
        playing = (chosen.agent or setup.agent or PLANNER,)
    kind = with_options_of(kind, [*playing, *filter(None, [chosen.student])])
    required = {
        each.name: tyro.MISSING_NONPROP
        for each in fields(kind)
        if each.default is each.default_factory is MISSING
    }

    def read(**defaults: Any) -> Command:
        default = setup.applied_to(replace(kind(**required), **defaults))
        return parse(kind, prog, words, replace(default, **own))

    return read


def with_options_of(kind: type[Command], agents: Sequence[str]) -> type[Command]:
    """Return `kind` with a field for the options of each of the agents.

    Raises CadenzaError if there is no such agent, or its options have a name that is taken.
    """
    names: dict[str, str] = {}
    taken = {*dir(kind), *(each.name for each in fields(kind))}
    # Options of the planner hold for practised plans, too.
    named = (PLANNER if (Path(agent) / PRACTISED).is_file() else agent for agent in agents)
    for agent in dict.fromkeys(named):
        if agent.startswith(TRAIN) or is_folder(agent) or agent_options(agent) is None:
            continue
        name = options_name(agent)
        if name in taken or not name.isidentifier() or iskeyword(name):
            option = name.replace("_", "-")
            raise CadenzaError(
                f"agent {agent}: its options cannot be called --{option}, as something else is or "
                "as that is no name; give the agent another one"
            )
        names[agent] = name
        taken.add(name)
    configs: dict[str, Any] = {name: agent_options(agent) for agent, name in names.items()}
    return make_dataclass(
        kind.__name__,
        [(name, config, field(default_factory=config)) for name, config in configs.items()],
        bases=(kind,),
        namespace={"__doc__": kind.__doc__, "options": names},
        frozen=True,
    )


def split_agents(words: Sequence[str]) -> list[str]:
    """The agents in words such as "planner,zero"; a policy's folder may have commas."""
    return [
        name
        for word in words
        for name in ([word] if os.path.isdir(word) else word.split(","))
        if name
    ]


@contextmanager
def setting_up(command: Options, song: str | None, player: Player, seed: int) -> Iterator[Setup]:
    """`set_up` with the options of a command; shows the progress of the search for fingers."""
    from cadenza.performing.setup import set_up

    with ExitStack() as kept:
        with stages("playing") as progress:
            setup = set_up(
                song,
                replace(player, task=command.task, scene=command.scene),
                arrangement=command.arrangement,
                seed=seed,
                num_threads=command.num_threads,
                progress=progress,
            )
            ready = kept.enter_context(setup)
        yield ready
