"""`cadenza play` and `plan`, with which the hands play a song, and `film`, which films it."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from cadenza.agents.registry import PLANNER, PLAYBACK, PRACTISED
from cadenza.cli.arguments import Output, Quiet, SoundFont, Verbose
from cadenza.cli.options import AGENTS_HELP, SONG, Options, Read, setting_up
from cadenza.cli.practice import practised
from cadenza.cli.progress import stages, stop_on_signal
from cadenza.cli.saving import (
    agent_folder,
    check_name,
    check_sheet,
    check_writable,
    default_folder,
    print_verdict,
    save,
    write_sheet,
)
from cadenza.files import TENSORS
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig

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


@dataclass(frozen=True)
class Film:
    """Make a film of a folder that "cadenza play" wrote, or the sound alone.

    Example: cadenza film played/OdeToJoy/planner --size 1080 1920 --seconds 20

    The film is the page of the performance, drawn by Chrome, Chromium or Edge: 60 pictures a
    second with a graphics card, 30 without, each of which then takes half a second of a core.
    """

    folder: tyro.conf.Positional[Path]
    """The folder of a performance."""
    output: Output[Path | None] = None
    """The file; its ending says what it is: .mp4 a film, .wav, .flac or .mp3 the sound alone.
    video.mp4 in the folder by default."""
    start: float = 0.0
    """Where in the performance the film begins [s]."""
    seconds: float | None = None
    """Length; to the end by default."""
    size: tuple[int, int] = (1920, 1080)
    """Width and height [px], up to 2160."""
    camera: str = "player"
    """player, close, top, audience or side."""
    score: bool = False
    """Show the score below the hands."""
    sound_font: SoundFont = None
    quiet: Quiet = False


def make_film(command: Film) -> None:
    from cadenza.cli.saving import film
    from cadenza.performing.filming import Look
    from cadenza.report.sound import voice_of

    look = Look(*command.size, command.camera, command.score, command.start, command.seconds)
    film(command.folder, voice_of(command.sound_font), command.output, look)


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


def plan(command: PlanCommand, _: Read[PlanCommand]) -> None:
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
    """Return the options with which "cadenza play" replays what `command` has planned."""
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
    """Return the words that give an option this value on a command line."""
    option = name.replace("_", "-")
    if isinstance(value, bool):
        return [f"--{'' if value else 'no-'}{option}"]
    values = value if isinstance(value, tuple) else (value,)
    return [f"--{option}", *map(str, values)]
