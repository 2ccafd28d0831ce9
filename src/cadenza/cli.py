"""The command line: a function a sub-command."""

from __future__ import annotations

import json
import math
import os
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args

import tyro

from cadenza.agents.planning.config import (
    ILQGConfig,
    PredictiveSamplingConfig,
    ScorePlannerConfig,
)
from cadenza.agents.rl.config import Preset, TrainingConfig, preset
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig
from cadenza.tasks.config import TaskConfig

# What is heavy to import is imported by the function that needs it, so that --help is quick.
if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cadenza.agents.agent import Agent
    from cadenza.agents.planning.misses import Miss
    from cadenza.agents.planning.score_planner import ScorePlanner
    from cadenza.agents.play import Performance
    from cadenza.agents.rl.policy_folder import LearntPolicy
    from cadenza.agents.rl.training import Training
    from cadenza.music.score import Score
    from cadenza.report.training import Curve
    from cadenza.tasks.piano_task import PianoTask

_AGENTS = ("planner", "predictive-sampling", "ilqg", "zero", "random", "pretrained")


def _with_time_to_begin() -> TaskConfig:
    """From where they start, the hands cannot sound a note at time 0."""
    return TaskConfig(initial_buffer_time=0.5)


@dataclass(frozen=True)
class _Performing:
    """What all that perform a song have in common."""

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")]
    """A bundled song (see "cadenza songs"), the path of a MIDI file, or the folder of a policy,
    which holds the song that it has learnt."""
    task: tyro.conf.OmitArgPrefixes[TaskConfig] = field(default_factory=_with_time_to_begin)
    scene: tyro.conf.OmitArgPrefixes[SceneConfig] = field(default_factory=SceneConfig)
    planner: ScorePlannerConfig = field(default_factory=ScorePlannerConfig)

    @property
    def default_folder(self) -> Path:
        return Path("played") / Path(self.song).stem


@dataclass(frozen=True)
class _WithOtherPlanners(_Performing):
    """The paper's planners have options of their own."""

    predictive_sampling: PredictiveSamplingConfig = field(default_factory=PredictiveSamplingConfig)
    ilqg: ILQGConfig = field(default_factory=ILQGConfig)


@dataclass(frozen=True)
class Play(_WithOtherPlanners):
    """Have the hands play a song, and leave sound, video, scores and a page to look at.

    Example: cadenza play OdeToJoy -o joy
    """

    agent: str = "planner"
    """Who plays: planner, predictive-sampling, ilqg, zero or random; replay, which plays the
    actions of --plan; pretrained, the policy that comes with a song; or the folder of a policy."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; played/SONG by default. Files of an earlier run are replaced."""
    seed: int = 0
    """Of everything random; the same seed plays the same."""
    plan: Path | None = None
    """For --agent replay: what "cadenza plan" wrote, or another .npz file with an array "action"
    (T, A) in actuator units."""
    video: bool = True
    """Write video.mp4 too, where this machine can draw."""


@dataclass(frozen=True)
class Plan(_Performing):
    """Plan how to play a song, and keep the actions and the fingers.

    Example: cadenza plan OdeToJoy -o joy.npz
    """

    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """The plan, a .npz file; played/SONG/plan.npz by default. Which finger plays which note stands
    as text beside it, in a file of the same name that ends in .fingering."""
    seed: int = 0
    """Of everything random; the same seed plans the same."""


@dataclass(frozen=True)
class Compare(_WithOtherPlanners):
    """Have several agents play the same song, and draw how they do.

    Example: cadenza compare OdeToJoy --agents planner predictive-sampling --seeds 0 1 2
    """

    agents: tuple[str, ...] = ("planner", "predictive-sampling")
    """Who plays, named as in "cadenza play", without replay."""
    seeds: tuple[int, ...] = (0,)
    """Each agent plays once with each."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for compare.html and compare.json; played/SONG by default."""


@dataclass(frozen=True)
class Train:
    """Have a policy learn a song, to be stopped at any moment and resumed.

    Example: cadenza train TwinkleTwinkleLittleStar -o twinkle; cadenza train --resume twinkle
    """

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A bundled song (see "cadenza songs") or the path of a MIDI file."""
    preset: Preset = "fast"
    """Where the options below begin: what suits few cores; the table of the paper; or what the
    published run script says."""
    resume: Path | None = None
    """Folder of a run that is to go on, with the options that it has."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder of the run; runs/SONG by default."""
    num_cores: int = 2
    """Cores to work on, of those that no other run has claimed."""
    wandb: str | None = None
    """Project of Weights & Biases to send figures to; TensorBoard files are always written."""
    video: bool = True
    """Write a video of the best policy too, where this machine can draw."""
    training: tyro.conf.OmitArgPrefixes[TrainingConfig] = field(
        default_factory=lambda: preset("fast")
    )


@dataclass(frozen=True)
class Curves:
    """Draw the learning curves of several runs together.

    Example: cadenza curves runs/joy_0 runs/joy_1 -o curves.html
    """

    runs: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="RUN...")]
    """Folders of runs, finished or not."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("curves.html")
    """The page."""


@dataclass(frozen=True)
class Songs:
    """List the bundled songs."""


@dataclass(frozen=True)
class Info:
    """Tell what a song asks for; without a song, what this installation can do."""

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A bundled song or the path of a MIDI file."""


def play(command: Play) -> None:
    from cadenza.agents.planning.misses import misses_of
    from cadenza.agents.planning.score_planner import ScorePlanner

    score = _score(command.song)
    if (learnt := _learnt(command.agent, command.song)) is not None:
        score, command = _as_learnt(learnt, score, command)
    agent = _player(command)
    if command.plan is not None:
        command = _as_planned(command.plan, command)
    task = _task(score, command)
    folder = command.output or command.default_folder
    _check_writable(folder)
    with closing(task):
        performance = _perform(task, agent, command.seed, "playing")
    misses = None
    if isinstance(agent, ScorePlanner):
        misses = misses_of(performance.episode, agent.score, agent.dropped, agent.nominal)
    _write_results(folder, command, performance, task, misses)
    _print_scores(performance)
    if isinstance(agent, ScorePlanner) and misses is not None:
        _print_what_was_lost(agent, performance, misses)
    print(f"\nOpen {folder / 'report.html'}")


def plan(command: Plan) -> None:
    from cadenza.agents.planning.misses import misses_of
    from cadenza.agents.planning.score_planner import ScorePlanner
    from cadenza.agents.replay import options_of, save_plan
    from cadenza.music.fingering_file import SUFFIX, write_fingering

    path = command.output or command.default_folder / "plan.npz"
    if path.suffix != ".npz":
        raise CadenzaError(f"{path}: a plan is a .npz file; choose a name that ends so")
    score = _score(command.song)
    agent = ScorePlanner(command.planner)
    task = _task(score, command)
    _check_writable(path.parent)
    with closing(task):
        performance = _perform(task, agent, command.seed, "planning")
    if performance.episode.num_steps < task.sheets.num_steps[0]:
        raise CadenzaError(
            f"{command.song}: ended after {performance.episode.num_steps} of "
            f"{task.sheets.num_steps[0]} steps, at a wrong key or an unstable simulation, so that "
            "there is no whole plan to keep; try another seed"
        )
    # The notes are the same in the same order; times and pitches are again those of the file.
    notes = zip(score.notes, agent.score.notes, strict=True)
    fingered = replace(score, notes=tuple(replace(n, finger=m.finger) for n, m in notes))
    options = options_of(command.task, command.scene, command.seed)
    save_plan(path, performance.episode, performance.metrics, options, fingered)
    write_fingering(fingered, path.with_suffix(SUFFIX))
    _print_scores(performance)
    misses = misses_of(performance.episode, agent.score, agent.dropped, agent.nominal)
    _print_what_was_lost(agent, performance, misses)
    print(f"\nFingers in {path.with_suffix(SUFFIX)}; to see and hear the plan:")
    print(shlex.join(["cadenza", "play", command.song, *_to_replay(command, path)]))


def compare(command: Compare) -> None:
    from cadenza.report.comparison import Run, in_text, means, write_comparison

    if not command.agents or not command.seeds:
        raise CadenzaError("nothing to compare: name at least one agent and one seed")
    score = _score(command.song)
    agents = {name: _agent(name, command) for name in command.agents}
    task = _task(score, command)
    folder = command.output or command.default_folder
    _check_writable(folder)
    runs = []
    with closing(task):
        for (name, agent), seed in product(agents.items(), dict.fromkeys(command.seeds)):
            performance = _perform(task, agent, seed, f"{name}, seed {seed}")
            figures = _figures(performance, command.task)
            runs.append(Run(name, seed, figures, performance.episode))
    content = {
        "means": means(runs),
        "runs": [{"agent": run.agent, "seed": run.seed, **run.figures} for run in runs],
        "settings": asdict(command),
    }
    _write_json(folder / "compare.json", content)
    write_comparison(folder / "compare.html", runs)
    print(in_text(runs))
    print(f"\nOpen {folder / 'compare.html'}")


def _figures(performance: Performance, config: TaskConfig) -> dict[str, float]:
    """What is compared. The energy is that of all actuators, their power as of each step's end."""
    metrics = performance.metrics
    figures = {name: metrics[name] for name in ("f1", "precision", "recall", "note_onset_f1")}
    energy = math.nan
    if config.energy_coefficient and "reward/energy" in metrics:
        energy = -metrics["reward/energy"] / config.energy_coefficient * config.control_timestep
    error = metrics["timing_error"]
    return figures | {
        "timing_error": math.nan if error is None else error,
        "energy": energy,
        "planning": metrics["planning_seconds"] / _seconds_of_music(performance),
    }


def _seconds_of_music(performance: Performance) -> float:
    return performance.episode.num_steps * performance.episode.dt


def train(command: Train) -> None:
    from cadenza.agents.rl.cores import claimed_cores

    if (command.song is None) == (command.resume is None):
        raise CadenzaError("name a song to learn, or with --resume the folder of a run")
    if command.resume is not None and command.training != preset("fast"):
        raise CadenzaError(f"{command.resume}: goes on with its own options; leave out all others")
    if command.num_cores < 1:
        raise CadenzaError(f"num_cores {command.num_cores}: choose 1 or more")
    folder = command.resume or command.output or Path("runs") / Path(str(command.song)).stem
    with claimed_cores(command.num_cores) as cores:
        if not cores:
            print("all cores are claimed by other runs: sharing one", file=sys.stderr)
        _train(command, folder)


def _train(command: Train, folder: Path) -> None:
    try:
        from cadenza.agents.rl.training import Training
    except ImportError as error:
        raise CadenzaError(f"training needs more ({error}): pip install '.[train]'") from error
    from cadenza.agents.rl.run_folder import RunFolder

    run = RunFolder(folder)
    if command.song is not None:
        score = _score(command.song)
        _check_writable(folder)
        run.begin(command.training, score)
    config, score = run.settings()
    with run.locked(), closing(Training(config, score, run)) as training:
        finished = _train_on(training, command, folder)
    if finished:
        best = str(folder / "best")
        play(Play(best, agent=best, output=folder / "best_played", video=command.video))
    _write_curves(folder, score.title, config)
    print(f"Learning curves in {folder / 'report.html'}")
    if not finished:
        print(f"to go on: cadenza train --resume {shlex.quote(str(folder))}", file=sys.stderr)
        raise KeyboardInterrupt


def _train_on(training: Training, command: Train, folder: Path) -> bool:
    """Trains until all is done, and then is true, or until someone asks to stop."""
    from tqdm import tqdm

    from cadenza.report.scalars import Scalars, TensorBoard, WeightsAndBiases

    shown: list[Scalars] = [TensorBoard(folder / "tensorboard", training.step)]
    if command.wandb:
        shown.append(WeightsAndBiases(command.wandb, folder, asdict(training.config)))
    often = 0.1 if sys.stderr.isatty() else 30.0  # seconds; a log file wants fewer lines
    steps, done = training.config.num_steps, training.step
    bar = tqdm(total=steps, initial=done, unit=" steps", mininterval=often)
    with bar, _asked_to_stop() as stop:

        def goes_on() -> bool:
            bar.update(training.step - bar.n)
            while training.rows:
                row = training.rows.popleft()
                for scalars in shown:
                    scalars.add(row)
                if "eval/f1" in row:
                    best = training.best["eval/f1"]
                    bar.set_postfix_str(f"F1 {row['eval/f1']:.3f}, best {best:.3f}")
            return not stop()

        training.run(goes_on)
        goes_on()
    for scalars in shown:
        scalars.close()
    return training.step >= training.config.num_steps


@contextmanager
def _asked_to_stop() -> Iterator[Callable[[], bool]]:
    """Yields what says whether Ctrl-C was pressed or the process told to end.

    Who presses it again does not want to wait for a checkpoint.
    """
    import signal

    asked = []

    def ask(number: int, _frame: Any) -> None:
        asked.append(number)
        signal.signal(number, before[signal.Signals(number)])
        print("\nstopping after a checkpoint; once more to stop at once", file=sys.stderr)

    before = {n: signal.signal(n, ask) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _write_curves(folder: Path, song: str, config: TrainingConfig) -> None:
    """The page of a run."""
    from cadenza.report.training import write_training

    pages = {"the best policy plays": "best_played/report.html", "video": "best_played/video.mp4"}
    links = {label: page for label, page in pages.items() if (folder / page).exists()}
    settings = _plain(asdict(config))
    write_training(folder / "report.html", song, [_curve(folder)], settings, links)


def curves(command: Curves) -> None:
    from cadenza.report.training import write_training

    if not command.runs:
        raise CadenzaError("no curves to draw: name at least one folder of a run")
    _check_writable(command.output.parent)
    drawn = [_curve(folder) for folder in command.runs]
    write_training(command.output, "Learning curves", drawn, {})
    print(f"Open {command.output}")


def _curve(run: Path) -> Curve:
    from cadenza.agents.rl.run_folder import read_rows
    from cadenza.report.training import Curve

    rows = read_rows(run)
    if not rows:
        raise CadenzaError(f"{run}: holds no figures of a run; name the folder of one")
    return Curve(run.name, rows)


def _score(song: str) -> Score:
    from cadenza.agents.rl.policy_folder import load_policy
    from cadenza.music.library import load_score

    score = load_policy(Path(song)).score if Path(song).is_dir() else load_score(song)
    for remark in score.remarks:
        print(f"{song}: {remark}", file=sys.stderr)
    return score


def _task(score: Score, command: _Performing) -> PianoTask:
    from cadenza.tasks.piano_task import PianoTask

    return PianoTask([score], command.task, command.scene)


def _perform(task: PianoTask, agent: Agent, seed: int, doing: str) -> Performance:
    from cadenza.agents.play import play as play_episode

    with _progress(doing, "steps") as advance:
        return play_episode(task, agent, seed, advance)


def _learnt(agent: str, song: str) -> LearntPolicy | None:
    """The policy that `agent` names, None where it names another agent."""
    from cadenza.agents.rl.policy_folder import load_policy
    from cadenza.agents.rl.pretrained import pretrained_folder

    if agent == "pretrained":
        return load_policy(pretrained_folder(song))
    return load_policy(Path(agent)) if Path(agent).is_dir() else None


def _as_learnt(learnt: LearntPolicy, score: Score, command: Play) -> tuple[Score, Play]:
    """With the options that the policy was trained with, but for those that the user changed."""

    def changed(options: Any, default: Any) -> dict[str, Any]:
        values = vars(options)
        return {name: v for name, v in values.items() if v != getattr(default, name)}

    task = replace(learnt.task, **changed(command.task, _with_time_to_begin()))
    scene = replace(learnt.scene, **changed(command.scene, SceneConfig()))
    if learnt.plan is not None:
        score, known = score.without_fingers(), learnt.score.without_fingers()
        if (score.notes, score.pedal) != (known.notes, known.pedal):
            raise CadenzaError(
                f"{command.agent}: corrects the plan of {known.title!r} and plays nothing else"
            )
    return score, replace(command, task=task, scene=scene)


def _as_planned(plan: Path, command: Play) -> Play:
    """In the physics of the plan; its other options must be those of the command."""
    from cadenza.agents.replay import check_options, options_of, physics_of

    check_options(plan, options_of(command.task, command.scene, command.seed))
    scene = replace(command.scene, **physics_of(plan))
    if scene.physics != command.scene.physics:
        print(f"{plan}: was made in the {scene.physics} physics, played in it", file=sys.stderr)
    return replace(command, scene=scene)


def _to_replay(command: Plan, path: Path) -> list[str]:
    """The options with which "cadenza play" replays what `command` has planned."""
    flags = ["--agent", "replay", "--plan", str(path)]
    for options, default in (
        (command.task, _with_time_to_begin()),
        (command.scene, SceneConfig()),
    ):
        for name, value in asdict(options).items():
            if value == getattr(default, name):
                continue
            flag = name.replace("_", "-")
            if isinstance(value, bool):
                flags.append(f"--{'' if value else 'no-'}{flag}")
            else:
                values = value if isinstance(value, tuple) else (value,)
                flags += [f"--{flag}", *map(str, values)]
    return [*flags, *(["--seed", str(command.seed)] if command.seed else [])]


def _player(command: Play) -> Agent:
    from cadenza.agents.replay import ReplayAgent, load_plan

    if command.agent == "replay" and command.plan is not None:
        return ReplayAgent(load_plan(command.plan))
    if command.agent == "replay" or command.plan is not None:
        raise CadenzaError("--agent replay and --plan FILE.npz go together: give both or neither")
    return _agent(command.agent, command)


def _agent(name: str, command: _WithOtherPlanners) -> Agent:
    from cadenza.agents.agent import RandomAgent, ZeroAgent
    from cadenza.agents.planning.ilqg import ILQG
    from cadenza.agents.planning.predictive_sampling import PredictiveSampling
    from cadenza.agents.planning.score_planner import ScorePlanner

    match name:
        case "planner":
            return ScorePlanner(command.planner)
        case "predictive-sampling":
            return PredictiveSampling(command.predictive_sampling)
        case "ilqg":
            return ILQG(command.ilqg)
        case "zero":
            return ZeroAgent()
        case "random":
            return RandomAgent()
    if (learnt := _learnt(name, command.song)) is not None:
        return learnt.agent
    raise CadenzaError(
        f"no agent {name!r}: choose from {', '.join(_AGENTS)}, or give the folder of a policy"
    )


def _check_writable(folder: Path) -> None:
    """Before anything is played for it."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise CadenzaError(
            f"{folder}: results cannot be written there ({error.strerror}); "
            "choose another folder with --output"
        ) from error


def _write_results(
    folder: Path,
    command: Play,
    performance: Performance,
    task: PianoTask,
    misses: Sequence[Miss] | None,
) -> None:
    """`misses` of the planner; it has to know the plan to say why."""
    from cadenza.music.midi import write_midi
    from cadenza.music.performance import performed_score
    from cadenza.report.page import write_report
    from cadenza.report.sound import synthesize

    episode, metrics = performance.episode, performance.metrics
    settings = _plain(asdict(command))
    played = performed_score(
        episode["key_activation"], episode["sustain_activation"], episode.dt, episode["key_qpos"]
    )
    episode.save(folder / "episode.npz")
    _write_json(folder / "metrics.json", metrics)
    _write_json(folder / "settings.json", settings)
    lost = [asdict(miss) for miss in misses or ()]
    if misses is not None:
        _write_json(folder / "misses.json", lost)
    write_midi(played, folder / "played.mid")
    with _progress("writing sound and page", "files") as advance:
        advance(0, 2)
        audio = synthesize(played)
        advance(1, 2)
        write_report(folder / "report.html", episode, metrics, settings, audio, misses=lost)
    if command.video:
        _write_video(folder / "video.mp4", performance, task, audio)


def _write_json(path: Path, content: Any) -> None:
    from cadenza.files import write_atomically

    with write_atomically(path) as file:
        file.write((json.dumps(_plain(content), indent=2, allow_nan=False) + "\n").encode())


def _write_video(path: Path, performance: Performance, task: PianoTask, audio: Any) -> None:
    from cadenza.report.sound import SAMPLE_RATE
    from cadenza.report.video import write_video
    from cadenza.sim.render import Renderer

    try:
        renderer = closing(Renderer(task.scene))
    except CadenzaError as error:
        print(f"no video: {error}", file=sys.stderr)
        return
    episode = performance.episode
    rows = zip(
        episode["hand_qpos"],
        episode["key_qpos"],
        episode["key_activation"],
        episode["goal_keys"],
        strict=True,
    )
    with renderer as draw, _progress("drawing", "frames") as advance:

        def frames() -> Iterator[NDArray[np.uint8]]:
            for done, row in enumerate(rows, start=1):
                yield draw.frame(*row)
                advance(done, episode.num_steps)

        write_video(path, frames(), 1 / episode.dt, audio, SAMPLE_RATE)


def songs(_: Songs) -> None:
    from cadenza.music.library import songs as pieces

    for piece in pieces():
        print(
            f"{piece.name:34} {piece.difficulty:12} {piece.seconds:5.1f} s  "
            f"{piece.title} ({piece.composer})"
        )


def info(command: Info) -> None:
    facts = _song_facts(command.song) if command.song else _installation_facts()
    width = max(len(name) for name in facts)
    for name, value in facts.items():
        print(f"{name:{width}}  {value}")


def _song_facts(song: str) -> dict[str, Any]:
    from cadenza.music.goals import score_to_goals
    from cadenza.music.library import load_score

    score = load_score(song)
    pitches = [note.pitch for note in score.notes]
    goals = score_to_goals(score.with_silence_trimmed(), TaskConfig().control_timestep)
    return {
        "title": score.title,
        "length": f"{score.with_silence_trimmed().total_time:.1f} s, {goals.num_steps} steps",
        "notes": len(score.notes),
        "range": f"MIDI {min(pitches)} to {max(pitches)}",
        "at once": f"up to {goals.keys.sum(axis=1).max()} keys",
        "fingering": _about_fingering(score),
        "pedal": f"{len(score.pedal)} movements",
    } | {f"repaired {i}": remark for i, remark in enumerate(score.remarks, start=1)}


def _about_fingering(score: Score) -> str:
    from collections import Counter

    from cadenza.music.fingering import find_fingering

    given = sum(note.finger >= 0 for note in score.notes)
    fingered, dropped = find_fingering(score)
    found = sum(note.finger >= 0 for note in fingered.notes) - given
    reasons = Counter(reason for _, reason in dropped)
    parts = [f"{given} of {len(score.notes)} notes"]
    parts += [f"found for {found}"] if found else []
    parts += [f"{count} cannot be played: {reason}" for reason, count in reasons.most_common()]
    return "; ".join(parts)


def _installation_facts() -> dict[str, Any]:
    import platform

    import mujoco

    from cadenza import __version__
    from cadenza.model.scene import build_scene
    from cadenza.sim.render import Renderer
    from cadenza.sim.simulation import available_cores

    try:
        Renderer(build_scene()).close()
        drawing = "yes"
    except CadenzaError as error:
        drawing = f"no; {error}"
    return {
        "cadenza": __version__,
        "python": platform.python_version(),
        "mujoco": mujoco.__version__,
        "cores": available_cores(),
        "can draw video": drawing,
    }


@contextmanager
def _progress(doing: str, unit: str) -> Iterator[Callable[[int, int], None]]:
    """A bar that appears after a second; yields what to call with steps done and in all."""
    from tqdm import tqdm

    with tqdm(desc=doing, unit=f" {unit}", delay=1.0, leave=False) as bar:

        def advance(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        yield advance


def _print_scores(performance: Performance) -> None:
    metrics = performance.metrics
    print(
        f"F1 {metrics['f1']:.3f}  precision {metrics['precision']:.3f}  "
        f"recall {metrics['recall']:.3f}  note onsets F1 {metrics['note_onset_f1']:.3f}"
    )
    print(
        f"{metrics['steps']} steps, return {metrics['return']:.1f}, "
        f"planned in {metrics['planning_seconds']:.1f} s and "
        f"simulated in {metrics['playing_seconds']:.1f} s for "
        f"{_seconds_of_music(performance):.1f} s of music"
    )
    if metrics["unstable"]:
        print("the simulation became unstable and the episode ended early", file=sys.stderr)


def _print_what_was_lost(
    agent: ScorePlanner, performance: Performance, misses: Sequence[Miss]
) -> None:
    from collections import Counter

    from cadenza.agents.planning.misses import in_a_line

    print(in_a_line(misses, performance.episode))
    reasons = Counter(reason for _, reason in agent.dropped)
    for reason, count in reasons.most_common():
        print(f"{count} of them have no finger: {reason}")


def _plain(value: Any) -> Any:
    """The same as JSON has it: paths as text, null for what is not a number."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and math.isnan(value):
        return None
    return str(value) if isinstance(value, Path) else value


_COMMANDS: dict[type, Callable[[Any], None]] = {
    Play: play,
    Plan: plan,
    Compare: compare,
    Train: train,
    Curves: curves,
    Songs: songs,
    Info: info,
}


def _named_preset(arguments: Sequence[str]) -> TrainingConfig:
    """The preset that the arguments name, which the other options then change, and --help shows."""
    words = [word for argument in arguments for word in argument.split("=", 1)]
    following = dict(pairwise(words))
    name = following.get("--preset", "fast")
    known: Any = name if name in get_args(Preset) else "fast"  # a wrong one is refused later
    return preset(known, "--residual" in arguments)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; exits 0 when done, 2 on wrong input, 130 when interrupted."""
    try:
        arguments = sys.argv[1:] if arguments is None else arguments
        defaults: dict[type, Any] = {Train: Train(training=_named_preset(arguments))}
        kinds: Any = tuple(
            Annotated[
                kind,
                tyro.conf.subcommand(
                    kind.__name__.lower(), default=defaults.get(kind, tyro.MISSING_NONPROP)
                ),
            ]
            for kind in _COMMANDS
        )
        command = tyro.cli(
            Union[kinds],  # noqa: UP007 - made of what there is
            prog="cadenza",
            description="Two simulated robot hands play the piano from any MIDI file.",
            args=arguments,
        )
        _COMMANDS[type(command)](command)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read the output has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (CadenzaError, OSError) as error:
        print(f"cadenza: {error}", file=sys.stderr)
        sys.exit(2)
    except RuntimeError as error:
        if "MUJOCO_GL" not in str(error):  # what MuJoCo says of a backend that it does not know
            raise
        print(f"cadenza: {error}; unset it, or choose egl or osmesa", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("cadenza: interrupted", file=sys.stderr)
        sys.exit(130)
