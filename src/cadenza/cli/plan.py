"""`cadenza plan`: how to play a song, kept as actions and fingers."""

import shlex
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from cadenza.agents.registry import PLANNER, PLAYBACK, PRACTISED
from cadenza.cli.arguments import Output, Quiet, Verbose
from cadenza.cli.options import SONG, Options, Read, setting_up
from cadenza.cli.printing import stages
from cadenza.cli.saving import (
    check_name,
    check_sheet,
    check_writable,
    default_folder,
    print_verdict,
    write_sheet,
)
from cadenza.files import TENSORS
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig


@dataclass(frozen=True)
class PlanCommand(Options):
    """Plan a song, and write the actions and the fingering to files.

    Example: cadenza plan OdeToJoy -o joy.safetensors
    """

    song: Annotated[tyro.conf.Positional[str], SONG] = field(kw_only=True)
    output: Output[Path | None] = None
    """The plan, a .safetensors file; played/SONG/plan.safetensors by default. The fingering is
    written beside it as text, to a file that ends in .safetensors.fingering."""
    score: Path | None = None
    """Write the song with the planned fingers as sheet music, too: a .pdf to print, a .musicxml
    file to edit, an .svg picture or a .mid file."""
    seed: int = 0
    """Random seed."""
    verbose: Verbose = False
    quiet: Quiet = False


def run(command: PlanCommand, _: Read[PlanCommand]) -> None:
    from cadenza.performing.performance import perform
    from cadenza.performing.planning import fingering_of, plan_of
    from cadenza.performing.setup import find_player

    if command.output is not None:
        check_name(command.output, TENSORS, f"a plan is a {TENSORS} file")
    if command.score is not None:
        check_sheet(command.score, "--score")
    player = find_player(PLANNER, configs=command.configs)
    with setting_up(command, command.song, player, command.seed) as setup:
        path = command.output or default_folder(setup) / PRACTISED
        check_writable(path.parent)
        with stages("planning") as progress:
            planned = plan_of(setup, perform(setup, progress))
    planned.save(path)
    print_verdict(planned.performance, command.verbose)
    if command.score is not None:
        write_sheet(planned.score_played, command.score)
    print(f"\nFingering in {fingering_of(path)}. To see and hear the plan:")
    print(shlex.join(["cadenza", "play", command.song, *_to_replay(command, path)]))


def _to_replay(command: PlanCommand, path: Path) -> list[str]:
    """The options with which "cadenza play" replays what `command` has planned."""
    from cadenza.configs import flat

    flags = ["--agent", PLAYBACK, "--plan", str(path)]
    for options, default in (
        (command.task, TaskConfig()),
        (command.scene, SceneConfig()),
        (command.arrangement, Arrangement()),
    ):
        usual = dict(flat(asdict(default)))
        for name, value in flat(asdict(options)):
            if value != usual[name]:
                flags += _as_option(name, value)
    return [*flags, *(["--seed", str(command.seed)] if command.seed else [])]


def _as_option(name: str, value: Any) -> list[str]:
    """The words that give an option this value on a command line."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{'' if value else 'no-'}{option}"]
    values = value if isinstance(value, tuple) else (value,)
    return [f"--{option}", *map(str, values)]
