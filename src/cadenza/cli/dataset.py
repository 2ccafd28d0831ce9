"""`cadenza dataset`: demonstrations to learn from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from cadenza.agents.registry import PLAYBACK, PRETRAINED, is_folder
from cadenza.cli.arguments import Flat, Output, Quiet
from cadenza.cli.options import Options, Read, RecordedParts
from cadenza.cli.printing import progress, stages
from cadenza.cli.runs import Execution, Work, check_execution, run_all
from cadenza.cli.saving import check_writable
from cadenza.configs import check_ranges, whole_number
from cadenza.errors import CadenzaError, counted
from cadenza.evaluation.collecting.variation import Variation, collecting_task
from cadenza.tasks.config import TaskConfig

if TYPE_CHECKING:
    from cadenza.evaluation.collecting.collect import Demonstrator
    from cadenza.evaluation.jobs import BenchJob

_MAX_EPISODES = 1_000_000


@dataclass(frozen=True)
class Collect(Options):
    """Have an agent play songs in many ways, and record demonstrations to learn from.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza dataset collect --songs OdeToJoy -o demonstrations
    """

    songs: str = "bundled"
    """A song, a library, see "cadenza libraries", or a folder. LIBRARY:SPLIT is a split of it."""
    agent: str = "planner"
    """Who plays: any agent of "cadenza play" but playback and policies."""
    episodes: int = 4
    """Episodes of each song. With more than before, the folder is extended."""
    output: Output[Path] = Path("demonstrations")
    """Folder of the episodes, which is extended if it holds some already."""
    least_f1: float = 0.8
    """Minimum F1 and note onset F1 of an episode to be kept. Others are only counted."""
    variation: Flat[Variation] = field(default_factory=Variation)
    task: Flat[TaskConfig] = field(default_factory=collecting_task)
    num_threads: int = 1
    """Threads of each episode."""
    execution: Flat[Execution] = field(default_factory=Execution)
    quiet: Quiet = False


def collect(command: Collect, _: Read[Collect]) -> None:
    from cadenza.evaluation.collecting.collect import episodes, is_complete, record
    from cadenza.music.libraries.library import open_library

    _check(command)
    library = open_library(command.songs)
    jobs = episodes(library, _demonstrator(command), range(command.episodes), command.least_f1)
    if not jobs:
        raise CadenzaError("there is nothing to play: choose other songs")
    until, summary = "ending the episodes under way", ["cadenza", "dataset", "info"]
    work = Work(record, is_complete, _outcome, until, [*summary, str(command.output)])
    run_all(command.output, command.num_threads, command.execution, jobs, work)


def _check(command: Collect) -> None:
    from cadenza.music.score import Note, Score
    from cadenza.tasks.piano_task import PianoTask

    check_execution(command.num_threads, command.execution)
    whole_number(command.episodes, "episodes", 1, _MAX_EPISODES)
    check_ranges(command, {"least_f1": (0, 1)})
    check_ranges(command.variation, {"noise": (0, 10)})
    if command.variation.excerpt is not None:
        check_ranges(command.variation, {"excerpt": (1, 3600)})
    if command.scene.hands == "none":
        raise CadenzaError("--hands none: there are no hands to learn from; choose some")
    if command.task.wrong_press_termination:
        raise CadenzaError(
            "--wrong-press-termination: demonstrations last as long as their songs; leave it out"
        )
    # Conflicting options of task and scene are one error here, instead of an error per episode.
    PianoTask([Score((Note(0.0, 0.1, 60),))], command.task, command.scene).close()


def _demonstrator(command: Collect) -> Demonstrator:
    from cadenza.agents.registry import make_agent
    from cadenza.evaluation.collecting.collect import Demonstrator
    from cadenza.learning.policy_folder import load_policy

    agent = command.agent
    if command.arrangement.asks_for_hands:
        raise CadenzaError("songs are recorded as written: leave out --arrange and --level")
    if agent in (PLAYBACK, PRETRAINED) or is_folder(agent):
        raise CadenzaError(f"--agent {agent}: does not plan, nor play any song; choose the planner")
    student = command.variation.student
    learnt = student is not None and is_folder(student)
    if learnt and load_policy(Path(str(student))).score is not None:
        raise CadenzaError(f"--student {student}: has learnt one song; give a policy for many")
    playing = [agent] if student is None or learnt else [agent, student]
    configs = {name: command.configs.get(name) for name in playing}
    for name, config in configs.items():
        make_agent(name, config)  # an unknown agent is an error before any plays
    options = command.task, command.scene, command.arrangement, command.variation
    return Demonstrator(agent, configs[agent], *options, configs.get(student or ""))


def _outcome(folder: Path, _job: BenchJob) -> str:
    from cadenza.demonstrations.recorded_episode import read_facts

    facts = read_facts(folder)
    remark = "" if facts.kept else ", not kept"
    scores = f"F1 {facts.f1:.3f}, note onset F1 {facts.note_onset_f1:.3f}"
    return f"{scores}, {counted(facts.num_steps, 'step')}{remark}"


@dataclass(frozen=True)
class DatasetInfo:
    """Say what a folder of demonstrations holds: songs, episodes, steps, F1, size, versions.

    Example: cadenza dataset info demonstrations
    """

    folder: tyro.conf.Positional[Path]
    """Folder of the demonstrations."""


def info(command: DatasetInfo) -> None:
    from cadenza.demonstrations.summary import summarize

    print(*summarize(command.folder), sep="\n")


@dataclass(frozen=True)
class DatasetPlay(RecordedParts):
    """Play a recorded episode again, and write a report page with sound, scores and MIDI.

    Example: cadenza dataset play demonstrations 0
    """

    folder: tyro.conf.Positional[Path]
    """Folder of the demonstrations."""
    number: Annotated[tyro.conf.Positional[int], tyro.conf.arg(metavar="N")]
    """Number of the episode, from 0, among kept ones, in the order of their folders' names."""
    output: Output[Path | None] = None
    """Folder for the results; played/FOLDER/N by default."""
    video: tyro.conf.FlagCreatePairsOff[bool] = False
    """Make a film, too, as "cadenza film" does."""
    quiet: Quiet = False


def play(command: DatasetPlay) -> None:
    from cadenza.cli.saving import save
    from cadenza.demonstrations.dataset import dataset_folder, kept
    from cadenza.performing.performance import check_replaceable
    from cadenza.performing.replaying import replay_episode

    demonstrations = dataset_folder(command.folder)
    episodes = kept(demonstrations)
    number = whole_number(command.number, "episode", 0, max(len(episodes) - 1, 0))
    if not episodes:
        raise CadenzaError(f"{command.folder}: no episode was kept")
    folder = command.output or Path("played") / demonstrations.resolve().name / str(number)
    check_writable(folder)
    check_replaceable(folder)
    with stages("playing") as reporter:
        performance = replay_episode(episodes[number], reporter)
    print(f"{episodes[number].facts.song}, {episodes[number].folder.name}")
    save(performance, folder, command.video, verbose=True)


@dataclass(frozen=True)
class DatasetExport(RecordedParts):
    """Write demonstrations for other libraries: Minari, or LeRobot v3.

    Example: cadenza dataset export demonstrations --format lerobot -o lerobot
    """

    folder: tyro.conf.Positional[Path]
    """Folder of the demonstrations."""
    output: Output[Path]
    """A new folder; for Minari, maybe one with other datasets, which MINARI_DATASETS_PATH names."""
    format: Literal["minari", "lerobot"] = "minari"
    """Format of the dataset."""
    name: str | None = None
    """For Minari: name in its id, by default cadenza/ and the name of the folder."""
    version: int = 0
    """For Minari: version in its id."""
    video_cameras: tuple[str, ...] = ()
    """Cameras that see every step, of player, close, top, audience and side, and the published
    closeup, left, right, back, egocentric and topdown. LeRobot has videos, and Minari pictures as
    infos, which take much space."""
    video_size: tuple[int, int] = (640, 360)
    """Width and height of what they see [px], up to 1920 1080; of videos even numbers."""
    quiet: Quiet = False


def export(command: DatasetExport) -> None:
    from cadenza.demonstrations.dataset import open_dataset
    from cadenza.demonstrations.lerobot_export import write_lerobot
    from cadenza.demonstrations.minari_export import minari_id, write_minari
    from cadenza.sim.render import Picture

    pictures = [Picture(*command.video_size, name) for name in dict.fromkeys(command.video_cameras)]
    if command.format != "minari" and (command.name, command.version) != (None, 0):
        raise CadenzaError("--name, --version: only Minari has them; leave them out")
    id_ = minari_id(command.folder, command.name, command.version)
    dataset = open_dataset(command.folder)
    with progress("exporting", "episodes") as advance:
        if command.format == "minari":
            write_minari(dataset, command.output, id_, advance, pictures)
        else:
            write_lerobot(dataset, command.output, advance, pictures)
    what = f"the dataset {id_}" if command.format == "minari" else "a LeRobot dataset"
    print(f"{counted(len(dataset.episodes), 'episode')}: {what} in {command.output}")
