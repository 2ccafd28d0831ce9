"""What the commands that perform a song share: options, who plays, scores."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, fields, make_dataclass, replace
from itertools import islice, takewhile
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import tyro

from cadenza.agents.registry import AGENTS, agent_options, options_name
from cadenza.cli.arguments import Advanced, option_parts
from cadenza.cli.output import counted
from cadenza.cli.progress import stages
from cadenza.cli.setups import SETUP_HELP
from cadenza.errors import CadenzaError
from cadenza.files import folder_name
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig, with_time_to_begin

if TYPE_CHECKING:
    from cadenza.performing.performance import Performance
    from cadenza.performing.setup import Selection, Setup

Command = TypeVar("Command", bound="Options")
Again = Callable[[Command], Command]
"""Reads the same command line again, with what it does not say taken from a command."""

_REWARDED = {
    "score": "; the score's fingers are rewarded",
    "found": "; fingers that a search found are rewarded",
    "transport": "; the nearest fingers are rewarded",
}
TRAIN = "train:"  # what the name of an agent begins with that is trained first

AGENTS_HELP = (
    'Who plays: a name that "cadenza info" lists, the folder of a policy, or module:Class. By '
    "default the planner, or the policy whose folder is SONG. --help-all shows its options."
)


@dataclass(frozen=True)
class Options:
    """What all that have agents play have in common."""

    arrangement: tyro.conf.OmitArgPrefixes[Arrangement] = field(default_factory=Arrangement)
    setup: Annotated[str | None, tyro.conf.arg(help=SETUP_HELP)] = None
    task: tyro.conf.OmitArgPrefixes[TaskConfig] = field(default_factory=with_time_to_begin)
    scene: tyro.conf.OmitArgPrefixes[SceneConfig] = field(default_factory=SceneConfig)
    num_threads: Advanced[int | None] = None
    """Threads of a planner, two by default: one for each hand."""

    of_ours: ClassVar[Sequence[str]] = [name for name, entry in AGENTS.own.items() if entry.config]
    """Our agents whose options it has."""
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
    """A song is performed."""

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")] = field(kw_only=True)
    """A song by its name (see "cadenza songs"), a MIDI or MusicXML file, or the folder of a policy
    or of a practised song."""
    learner: Advanced[str | None] = None
    """Learner of a policy, if it was given as module:NAME."""


def with_options_of_agents(kind: type[Command], words: Sequence[str]) -> type[Command]:
    """`kind` with a field more for the options of each of our agents, and of those in `words`.

    Raises:
        CadenzaError: `words` name an agent that there is not, or its options are called like
            something else.
    """
    agents = {options_name(agent): agent for agent in kind.of_ours}
    taken = {*dir(kind), *(each.name for each in fields(kind))}
    for agent in dict.fromkeys(_named(words)):
        if agent.startswith(TRAIN) or os.path.isdir(agent) or agent_options(agent) is None:
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


def _named(words: Sequence[str]) -> Iterator[str]:
    """The agents that a command line names."""
    parts = option_parts(words)
    for i, option in enumerate(parts):
        if option in ("--agent", "--agents"):
            names = takewhile(lambda part: not part.startswith("-"), parts[i + 1 :])
            for name in islice(names, 1 if option == "--agent" else None):
                yield from agents_in(name) if option == "--agents" else (name,)


def agents_in(words: str) -> list[str]:
    """The agents in "planner,zero". The folder of a policy may have commas in its name."""
    return [words] if os.path.isdir(words) else [name for name in words.split(",") if name]


def selected(command: Performing, agent: str | None, plan: Path | None = None) -> Selection:
    """The song of a command, and whoever plays it with the options of the command."""
    from cadenza.performing.setup import select

    return select(
        command.song, agent, arrangement=command.arrangement, configs=command.configs, plan=plan
    )


def check_all_play(command: Options, agents: Collection[str]) -> None:
    """Before these `agents` play.

    Raises:
        CadenzaError: the command gives an option of another one.
    """
    for agent, config in command.configs.items():
        usual = type(config)()
        given = [
            f.name for f in fields(config) if getattr(config, f.name) != getattr(usual, f.name)
        ]
        if given and agent not in agents:
            option = f"{command.options[agent]}.{given[0]}".replace("_", "-")
            raise CadenzaError(f"--{option}: {agent} does not play; leave it out, or have it play")


def with_defaults_of(command: Command, selection: Selection, again: Again[Command]) -> Command:
    """The command with the selection's own task and scene where the command line says no other."""
    return again(replace(command, task=selection.task, scene=selection.scene))


@contextmanager
def setting_up(selection: Selection, command: Options, seed: int = 0) -> Iterator[Setup]:
    """`set_up` with the command's task and scene; shows how far the search for fingers is."""
    from cadenza.performing.setup import set_up

    with ExitStack() as kept:
        with stages("playing") as progress:
            setup = kept.enter_context(
                set_up(selection, command.task, command.scene, seed, progress, command.num_threads)
            )
        yield setup


def default_folder(selection: Selection) -> Path:
    """Where results of a song go."""
    from cadenza.music.formats.reading import name_without_ending
    from cadenza.performing.setup import is_own_folder

    song = selection.song
    name = selection.score.title if is_own_folder(song) else name_without_ending(song)
    return Path("played") / folder_name(name)


def print_scores(performance: Performance) -> None:
    """How well it was played, and how long that took."""
    metrics = performance.metrics
    print(
        f"F1 {metrics['f1']:.3f}  precision {metrics['precision']:.3f}  "
        f"recall {metrics['recall']:.3f}  note onsets F1 {metrics['note_onset_f1']:.3f}"
    )
    print(
        f"{performance.seconds:.1f} s of music in {counted(metrics['steps'], 'step')}; "
        f"planning took {metrics['planning_seconds']:.1f} s, "
        f"simulation {metrics['playing_seconds']:.1f} s"
    )
    print(_return_summary(metrics))
    if metrics["unstable"]:
        print("the simulation became unstable and the episode ended early", file=sys.stderr)


def _return_summary(metrics: Mapping[str, Any]) -> str:
    """The return and its terms, as agents are rewarded for fingers that not all of them use."""
    terms = {
        name.removeprefix("reward/").replace("_", " "): value
        for name, value in metrics.items()
        if name.startswith("reward/")
    }
    told = ", ".join(f"{name} {value:.1f}" for name, value in terms.items())
    fingers = _REWARDED.get(metrics["rewarded_fingers"], "")
    return f"return {metrics['return']:.1f}: {told}{fingers}"


def print_what_was_lost(performance: Performance) -> None:
    """How many notes, and why, if there was a plan."""
    from collections import Counter

    from cadenza.agents.planner.misses import summary

    if performance.track is None or performance.misses is None:
        return
    print(*summary(performance.misses, performance.episode), sep="\n")
    reasons = Counter(reason for _, reason in performance.track.dropped or ())
    for reason, count in reasons.most_common():
        print(f"no finger for {counted(count, 'note')}: {reason}")
