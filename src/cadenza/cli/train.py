"""`cadenza train`, where a policy learns a song, and `cadenza curves`, which draws how it did."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import tyro

from cadenza.cli.arguments import Chosen, Flat, Output, Quiet
from cadenza.cli.options import SETUP_HELP
from cadenza.cli.printing import SECONDS_BETWEEN_LINES_OF_TRAINING, progress, stages, stop_on_signal
from cadenza.cli.saving import check_name, check_writable, save
from cadenza.errors import CadenzaError
from cadenza.files import folder_name, plain
from cadenza.learning.config import TrainingConfig, preset
from cadenza.learning.learner import DROQ, Preset, name_of
from cadenza.music.arrangement import Arrangement, load
from cadenza.music.formats.reading import name_without_ending
from cadenza.registry import module_of
from cadenza.resumable import RateLimited
from cadenza.scene.config import named_by_module
from cadenza.tasks.setups import NamedSetup, setup_named

if TYPE_CHECKING:
    from cadenza.learning.run_folder import RunFolder
    from cadenza.learning.training import Training
    from cadenza.music.score import Score
    from cadenza.report.training_page import Curve

_PAGE = "report.html"
_MIN_PAGE_INTERVAL = 10.0  # [s] between two versions of the page of a run
_MAX_WRITING = 0.01  # share of the time that they take


@dataclass(frozen=True)
class Train:
    """Train a policy on songs. Ctrl-C stops the run, --resume continues it.

    Example: cadenza train TwinkleTwinkleLittleStar -o twinkle; cadenza train --resume twinkle
    """

    songs: Annotated[tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="[SONG...]")] = ()
    """Songs by their names (see "cadenza songs") or the paths of MIDI or MusicXML files. Of
    several, each episode plays one."""
    preset: Preset = "fast"
    """Hyperparameters to start from: fast for few cores, correcting what the planner plays unless
    there is --no-residual; paper for the paper's table, published for the published run script."""
    learner: str = DROQ
    """The algorithm: droq; ppo, for many environments and for --engine warp; one that another
    package adds, or module:NAME. --help lists its options."""
    resume: Path | None = None
    """Continue the run in this folder, with its own options. --num-steps changes its end. A hand,
    keyboard or learner given as module:NAME has to be given again."""
    output: Output[Path | None] = None
    """Folder of the run; runs/SONG by default, runs/SONG_and_2_more for three."""
    num_cores: int = 2
    """CPU cores to use. Cores that other runs have claimed are left out."""
    wandb: str | None = None
    """Also log to this Weights & Biases project. TensorBoard files are always written."""
    video: bool = False
    """Make a film of the best policy, too, as "cadenza film" does."""
    arrangement: Flat[Arrangement] = field(default_factory=Arrangement)
    setup: Annotated[str | None, tyro.conf.arg(help=SETUP_HELP)] = None
    quiet: Quiet = False
    training: Flat[TrainingConfig] = field(default_factory=lambda: preset("fast"))


@dataclass(frozen=True)
class Curves:
    """Plot the learning curves of several runs on one page.

    Example: cadenza curves runs/joy_0 runs/joy_1 -o curves.html
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Folders of runs, finished or not."""
    output: Output[Path] = Path("curves.html")
    """The page, a .html file."""
    learner: str | None = None
    """Learner of the runs, if it was given as module:NAME."""


def default(chosen: Chosen) -> Train:
    """The command with the training of a resumed run, or of a preset.

    Raises CadenzaError if there is no such run, learner or setup.
    """
    setup = NamedSetup() if chosen.setup is None else setup_named(chosen.setup)
    if chosen.resume is not None:
        from cadenza.learning.run_folder import RunFolder

        training, _ = RunFolder(chosen.resume).description()
    else:
        learner = chosen.learner or DROQ
        residual = chosen.residual or (False if chosen.no_residual else None)
        training = preset(chosen.preset, residual, learner, setup.training)
    return Train(training=setup.applied_to(training))


def train(command: Train) -> None:
    from cadenza.learning.cpu_affinity import claimed_cores

    if bool(command.songs) == (command.resume is not None):
        raise CadenzaError("give a song to learn, or the folder of a run with --resume")
    if command.resume is not None:
        learners = Train.learner, name_of(command.training.learner)
        other = command.learner not in learners or command.preset != Train.preset
        for is_given, what, options in (
            (other, "options", "--preset and --learner"),
            (command.arrangement.chosen, "song", "--tracks, --plain and --expression"),
            (command.output is not None, "folder", "--output"),
        ):
            if is_given:
                raise CadenzaError(
                    f"{command.resume}: a resumed run keeps its own {what}; leave out {options}"
                )
    if command.arrangement.asks_for_hands:
        raise CadenzaError(
            "songs are learnt as written: write an arrangement with cadenza arrange, and train on "
            "that; leave out --arrange and --level"
        )
    if command.num_cores < 1:
        raise CadenzaError(f"num_cores {command.num_cores}: choose 1 or more")
    folder = command.resume or command.output or Path("runs") / _name_of(command.songs)
    with claimed_cores(command.num_cores):
        _train(command, folder)


def _name_of(songs: Sequence[str]) -> str:
    """The name of the folder of a run, and what its pages are called."""
    from cadenza.music.libraries.library import find_song

    first, *more = songs
    suffix = f"_and_{len(more)}_more" if more else ""
    return folder_name(name_without_ending(find_song(first).name)) + suffix


def _title(scores: Sequence[Score]) -> str:
    first, *more = scores
    return first.title + (f" and {len(more)} more" if more else "")


def _train(command: Train, folder: Path) -> None:
    from cadenza.learning.policy_folder import load_policy
    from cadenza.learning.problem import problem_of
    from cadenza.learning.run_folder import RunFolder
    from cadenza.learning.training import Training, begin
    from cadenza.performing.performance import play
    from cadenza.report.training_page import need_wandb

    run = RunFolder(folder)
    if command.wandb:
        need_wandb()  # before a run begins for it
    if command.songs:
        hands = command.training.scene.hands
        loaded = [load(song, command.arrangement) for song in command.songs]
        scores = tuple(song.written_for(hands).score for song in loaded)
        check_writable(folder)
    with run.locked(), _prints_how_to_resume(folder, command.training):
        with stages("playing") as reporter:
            if command.songs:
                config = command.training
                training = begin(config, scores, run, reporter)
            else:
                run.set_end(command.training)
                config, scores = run.settings()
                saved = load_policy(last).reference if (last := folder / "last").is_dir() else None
                training = Training(problem_of(config, scores, reporter, saved), run)
        title = _title(scores)
        with closing(training):
            finished = _train_until_stopped(training, command, run, title)
        if finished:
            with stages("playing") as reporter:
                song = None if len(scores) == 1 else scores[0]  # a policy of one holds it
                performance = play(song, folder, progress=reporter)
            save(performance, folder / "best_played", command.video)
        if run.metrics.rows():
            _write_curves(folder, title, config)
            print(f"Learning curves in {folder / _PAGE}")
        if not finished:
            raise KeyboardInterrupt


@contextmanager
def _prints_how_to_resume(folder: Path, config: TrainingConfig) -> Iterator[None]:
    again = ["cadenza", "train", "--resume", str(folder)]
    for option, name in named_by_module(config.scene).items():
        again += [f"--{option}", name]
    if module_of(learner := name_of(config.learner)) is not None:
        again += ["--learner", learner]
    try:
        yield
    except KeyboardInterrupt:
        print(f"to continue: {shlex.join(again)}", file=sys.stderr)
        raise


def _train_until_stopped(training: Training, command: Train, run: RunFolder, song: str) -> bool:
    """Train until the last step, or until a signal; return whether the last step was reached."""
    from cadenza.report.training_page import TensorBoard, WeightsAndBiases

    logs: list[TensorBoard | WeightsAndBiases]
    logs = [TensorBoard(run.path / "tensorboard", training.step)]
    if command.wandb:
        settings = asdict(training.config)
        logs.append(WeightsAndBiases(command.wandb, run.path, run.id, settings))
    write_page = RateLimited(
        lambda: _write_curves(run.path, song, training.config, going_on=True),
        _MIN_PAGE_INTERVAL,
        _MAX_WRITING,
    )
    if (run.path / _PAGE).exists():
        write_page(at_once=True)  # as the run goes on
    scores = ""
    num_shown = len(training.rows)
    shown_steps = progress("learning", "steps", SECONDS_BETWEEN_LINES_OF_TRAINING)
    with shown_steps as advance, stop_on_signal("a checkpoint") as stop:
        stop()  # signals are caught from its first call on

        def should_continue() -> bool:
            nonlocal scores, num_shown
            for row in training.rows[num_shown:]:
                for log in logs:
                    log.add(row)
                write_page(at_once=not (run.path / _PAGE).exists())
                if "eval/f1" in row:
                    onsets, best = (r["eval/note_onset_f1"] for r in (row, training.best))
                    scores = f"F1 {row['eval/f1']:.3f}, note onset F1 {onsets:.3f}, "
                    scores += f"best {best:.3f}"
            num_shown = len(training.rows)
            advance(training.step, training.config.num_steps, scores)
            return not stop()

        training.run(should_continue)
        should_continue()
    for log in logs:
        log.close()
    return training.step >= training.config.num_steps


def _write_curves(folder: Path, song: str, config: TrainingConfig, going_on: bool = False) -> None:
    from cadenza.report.html_pages import write_page
    from cadenza.report.training_page import training_page

    pages = {"the best policy plays": "best_played/report.html", "video": "best_played/video.mp4"}
    links = {label: page for label, page in pages.items() if (folder / page).exists()}
    settings = plain(asdict(config))
    page = training_page(song, [_curve(folder)], settings, links, going_on)
    write_page(folder / _PAGE, page)


def curves(command: Curves) -> None:
    from cadenza.report.html_pages import write_page
    from cadenza.report.training_page import training_page

    if not command.runs:
        raise CadenzaError("no curves to draw: name at least one folder of a run")
    check_name(command.output, ".html", "curves are a .html page")
    check_writable(command.output.parent)
    drawn = [_curve(folder) for folder in command.runs]
    descriptions = [_title_and_settings(folder) for folder in command.runs]
    shared = set.intersection(*map(set, descriptions))
    tasks = [", ".join(part for part in parts if part not in shared) for parts in descriptions]
    apart = [replace(curve, task=task) for curve, task in zip(drawn, tasks, strict=True)]
    songs = dict.fromkeys(song for song, *_ in descriptions)
    write_page(command.output, training_page(" · ".join(songs), apart, {}))
    print(f"Open {command.output}")


def _title_and_settings(run: Path) -> list[str]:
    """The song of a run, its preset, and the settings that differ from it but the seed.

    Of a folder with figures only, the name without the number at the end stands for the song.
    """
    from cadenza.configs import flat
    from cadenza.learning.run_folder import RunFolder

    if not (run / "run.json").exists():
        return [re.sub(r"[ _-]*\d+$", "", run.name) or run.name]
    config, scores = RunFolder(run).description()

    def differences(name: Preset) -> list[str]:
        usual_config = preset(name, config.residual, name_of(config.learner))
        usual = dict(flat(asdict(replace(usual_config, seed=config.seed))))
        return [
            f"{setting.rpartition('.')[2].replace('_', ' ')} {value}"
            for setting, value in flat(asdict(config))
            if value != usual[setting]
        ]

    nearest = min(get_args(Preset), key=lambda name: len(differences(name)))
    return [_title(scores), nearest, *differences(nearest)]


def _curve(run: Path) -> Curve:
    from cadenza.learning.metrics_log import MetricsLog
    from cadenza.report.training_page import Curve

    rows = MetricsLog(run).rows()
    if not rows:
        raise CadenzaError(f"{run}: holds no metrics of a run; give the folder of a run")
    return Curve(run.name, rows)
