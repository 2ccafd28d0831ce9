"""`cadenza play`: the hands play a song, and leave a folder of results."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.cli.arguments import Output, Quiet, SoundFont, Verbose
from cadenza.cli.options import AGENTS_HELP, Options, Read, setting_up
from cadenza.cli.practice import practised
from cadenza.cli.printing import stages, stop_on_signal
from cadenza.cli.saving import agent_folder, check_writable, save

if TYPE_CHECKING:
    from cadenza.performing.setup import Setup


@dataclass(frozen=True)
class PlayCommand(Options):
    """Play a song, and write a report page with sound, scores and MIDI.

    Example: cadenza play OdeToJoy -o joy
    """

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A song by its name (see "cadenza songs"), or a MIDI or MusicXML file; by default the one that
    the agent has learnt or practised."""
    agent: Annotated[str | None, tyro.conf.arg(help=AGENTS_HELP)] = None
    output: Output[Path | None] = None
    """Folder for the results, which replace older ones; played/SONG/AGENT by default."""
    seed: int = 0
    """Random seed."""
    plan: Path | None = None
    """For --agent playback: a plan, or any .npz file with an array "action" (T, A)."""
    video: bool = False
    """Make a film, too, as "cadenza film" does."""
    sound_font: SoundFont = None
    learner: str | None = None
    """Learner of a policy, if it was given as module:NAME."""
    verbose: Verbose = False
    quiet: Quiet = False


def run(command: PlayCommand, read: Read[PlayCommand]) -> None:
    from cadenza.performing.performance import check_replaceable, perform
    from cadenza.performing.setup import find_player
    from cadenza.report.sound import voice_of

    player = find_player(command.agent, command.song, configs=command.configs, plan=command.plan)
    command = read(task=player.task, scene=player.scene)
    voice = voice_of(command.sound_font)  # says so before anything is played if it cannot be used
    with (
        stop_on_signal("writing the results") as stop,
        setting_up(command, command.song, player, command.seed) as setup,
    ):
        folder = command.output or agent_folder(setup)
        check_writable(folder)
        check_replaceable(folder, command.song)
        with _practised(setup, folder) as (ready, cut_short):
            with stages("playing") as progress:
                performance = perform(ready, progress, stop)
            save(performance, folder, command.video, voice, command.verbose)
            stopped = stop()
    if cut_short:
        print(f"stopped practice; the same command goes on in {folder}", file=sys.stderr)
    if stopped and performance.episode.num_steps < setup.num_steps:
        length = setup.num_steps * performance.episode.dt
        part = f"{performance.seconds:.1f} of {length:.1f} s"
        print(f"stopped after {part}: the results cover only that part", file=sys.stderr)
    if cut_short or stopped:
        raise KeyboardInterrupt


@contextmanager
def _practised(setup: Setup, folder: Path) -> Iterator[tuple[Setup, bool]]:
    """Yield the setup to play, practised if the planner is to, and whether Ctrl-C stopped that."""
    from cadenza.agents.planner.planner import Planner

    if not isinstance(setup.agent, Planner) or not setup.agent.config.effort:
        yield setup, False
        return
    with ExitStack() as kept:
        with stop_on_signal("this passage") as stop:
            effort = setup.agent.config.effort
            practising = kept.enter_context(practised(setup, folder, effort, stop=stop))
            stopped = stop()
        yield practising.best(), stopped
