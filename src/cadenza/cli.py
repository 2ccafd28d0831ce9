"""The command line: a function a sub-command."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from cadenza.agents.planning.config import PredictiveSamplingConfig
from cadenza.errors import CadenzaError
from cadenza.model.config import SceneConfig
from cadenza.tasks.config import TaskConfig

# What is heavy to import is imported by the function that needs it, so that --help is quick.
if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cadenza.agents.agent import Agent
    from cadenza.agents.play import Performance
    from cadenza.music.score import Score
    from cadenza.tasks.piano_task import PianoTask

AgentName = Literal["predictive-sampling", "zero", "random", "replay"]


@dataclass(frozen=True)
class Play:
    """Have the hands play a song, and leave sound, video, scores and a page to look at.

    Example: cadenza play OdeToJoy -o joy
    """

    song: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SONG")]
    """A bundled song (see "cadenza songs") or the path of a MIDI file."""
    agent: AgentName = "predictive-sampling"
    """Who plays. "replay" plays the actions of --plan."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for the results; played/SONG by default. Files of an earlier run are replaced."""
    seed: int = 0
    """Of everything random; the same seed plays the same."""
    plan: Path | None = None
    """For --agent replay: a .npz file with an array "action" (T, A) in actuator units."""
    video: bool = True
    """Write video.mp4 too, where this machine can draw."""
    task: tyro.conf.OmitArgPrefixes[TaskConfig] = field(default_factory=TaskConfig)
    scene: tyro.conf.OmitArgPrefixes[SceneConfig] = field(default_factory=SceneConfig)
    planner: PredictiveSamplingConfig = field(default_factory=PredictiveSamplingConfig)


@dataclass(frozen=True)
class Songs:
    """List the bundled songs."""


@dataclass(frozen=True)
class Info:
    """Tell what a song asks for; without a song, what this installation can do."""

    song: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[SONG]")] = None
    """A bundled song or the path of a MIDI file."""


def play(command: Play) -> None:
    from cadenza.agents.play import play as play_episode
    from cadenza.music.library import load_score
    from cadenza.tasks.piano_task import PianoTask

    score = load_score(command.song)
    for remark in score.remarks:
        print(f"{command.song}: {remark}", file=sys.stderr)
    agent = _agent(command)
    if command.plan is not None:
        command = _in_the_physics_of(command.plan, command)
    task = PianoTask([score], command.task, command.scene)
    folder = command.output or Path("played") / Path(command.song).stem
    _check_writable(folder)
    with closing(task), _progress("playing", "steps") as advance:
        performance = play_episode(task, agent, command.seed, advance)
    _write_results(folder, command, performance, task)
    _print_scores(performance.metrics)
    print(f"\nOpen {folder / 'report.html'}")


def _in_the_physics_of(plan: Path, command: Play) -> Play:
    from cadenza.agents.replay import physics_of

    scene = replace(command.scene, **physics_of(plan))
    if scene.physics != command.scene.physics:
        print(f"{plan}: was made in the {scene.physics} physics, played in it", file=sys.stderr)
    return replace(command, scene=scene)


def _agent(command: Play) -> Agent:
    from cadenza.agents.agent import RandomAgent, ZeroAgent
    from cadenza.agents.planning.predictive_sampling import PredictiveSampling
    from cadenza.agents.replay import ReplayAgent, load_plan

    if (command.agent == "replay") != (command.plan is not None):
        raise CadenzaError("--agent replay and --plan FILE.npz go together: give both or neither")
    if command.plan is not None:
        return ReplayAgent(load_plan(command.plan))
    if command.agent == "predictive-sampling":
        return PredictiveSampling(command.planner)
    return ZeroAgent() if command.agent == "zero" else RandomAgent()


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


def _write_results(folder: Path, command: Play, performance: Performance, task: PianoTask) -> None:
    import json

    from cadenza.files import write_atomically
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
    for name, content in (("metrics", metrics), ("settings", settings)):
        with write_atomically(folder / f"{name}.json") as file:
            file.write((json.dumps(content, indent=2) + "\n").encode())
    write_midi(played, folder / "played.mid")
    with _progress("writing sound and page", "files") as advance:
        advance(0, 2)
        audio = synthesize(played)
        advance(1, 2)
        write_report(folder / "report.html", episode, metrics, settings, audio)
    if command.video:
        _write_video(folder / "video.mp4", performance, task, audio)


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
    from cadenza.agents.planning.predictive_sampling import available_cores
    from cadenza.model.scene import build_scene
    from cadenza.sim.render import Renderer

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


def _print_scores(metrics: dict[str, float]) -> None:
    print(
        f"F1 {metrics['f1']:.3f}  precision {metrics['precision']:.3f}  "
        f"recall {metrics['recall']:.3f}  note onsets F1 {metrics['note_onset_f1']:.3f}"
    )
    print(
        f"{metrics['steps']} steps, return {metrics['return']:.1f}, "
        f"planned in {metrics['planning_seconds']:.1f} s, "
        f"simulated in {metrics['playing_seconds']:.1f} s"
    )
    if metrics["unstable"]:
        print("the simulation became unstable and the episode ended early", file=sys.stderr)


def _plain(value: Any) -> Any:
    """The same with paths as text, for JSON."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return str(value) if isinstance(value, Path) else value


_COMMANDS: dict[type, Callable[[Any], None]] = {Play: play, Songs: songs, Info: info}


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; exits 0 when done, 2 on wrong input, 130 when interrupted."""
    try:
        command = tyro.extras.subcommand_cli_from_dict(
            {kind.__name__.lower(): kind for kind in _COMMANDS},
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
