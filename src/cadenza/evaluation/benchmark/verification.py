"""Plays an entry again: every recorded action, every metric anew; and makes one of a bench.

Nothing is taken from an entry but its actions and what they are compared with: the songs, the
scene and the task are those of the benchmark's definition.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.playback import Playback, load_plan
from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.definition import (
    DEPLOYMENT,
    METRICS,
    SCENE,
    TASK,
    VERSION,
    check_frozen,
    open_set,
    set_up_song,
)
from cadenza.evaluation.benchmark.deployment import AGENT, played_on_robot, robot_runs
from cadenza.evaluation.benchmark.entry import (
    ENTRY,
    BenchmarkEntry,
    EnteredRun,
    Metrics,
    actions_path,
    check_claims,
    check_files,
    read_entry,
    runs_by_song,
)
from cadenza.evaluation.results import Result, read_results
from cadenza.evaluation.run import versions
from cadenza.files import (
    FLOATS,
    ArrayOf,
    checked,
    new_folder,
    read_tensors,
    write_json,
    write_tensors,
)
from cadenza.music.arrangement import Arrangement
from cadenza.music.libraries.imported import Progress, silent
from cadenza.performing.setup import Setup
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig, task_identity

_HEADER = 4096  # bytes that a file of actions may take beside them


@dataclass(frozen=True)
class PlayedAgain:
    """An entry that was played again."""

    entry: BenchmarkEntry
    metrics: dict[tuple[str, int], Metrics]  # the metrics of every run (song, seed), computed here
    seconds: float  # length of all music that was played [s]
    # Where a metric that the entry claims is not computed here to the bit, in a line each
    differences: list[str]


def verify(folder: Path, progress: Progress = silent) -> PlayedAgain:
    """Play every run of an entry again, and compare; `progress` gets how many of how many.

    Raises CadenzaError if it is no whole entry, or cannot be played; the error says why in a line.
    """
    entry = read_entry(folder)
    by_song = runs_by_song(entry)
    check_files(folder, entry)
    differences = list[str]()
    metrics, seconds = dict[tuple[str, int], Metrics](), 0.0
    for song, runs in by_song:
        with set_up_song(song) as setup:
            digest = check_frozen(song, setup)
            for run in runs:
                where = f"{run.song}, seed {run.seed}"
                if run.song_digest != digest:
                    raise CadenzaError(
                        f"{where}: was recorded with other notes than the song has here ({digest})"
                    )
                actions = _actions(actions_path(folder, run.song, run.seed), setup)
                if entry.track == DEPLOYMENT:
                    computed = played_on_robot(actions, run.seed, setup)
                else:
                    computed = _played(actions, run.seed, setup, where)
                metrics[run.song, run.seed] = computed
                seconds += len(actions) * setup.task.config.control_timestep
                differences += [
                    f"{where}: {name} is {computed[name]} here, not {run.metrics[name]}"
                    for name in METRICS
                    if computed[name] != run.metrics[name]
                ]
                progress(len(metrics), len(entry.runs))
    return PlayedAgain(entry, metrics, seconds, differences)


def _actions(path: Path, setup: Setup) -> NDArray[np.float64]:
    """Read the actions (T, A) of a run, which are as many and as large as the task takes."""
    low, high = setup.task.spec.action_low, setup.task.spec.action_high
    steps = setup.task.tracks[0].goals.num_steps
    form = ArrayOf(FLOATS, (steps, len(low)), needed=True, finite=True)
    most = steps * len(low) * np.dtype(np.float64).itemsize + _HEADER
    actions: NDArray[Any] = read_tensors(path, {"action": form}, most)[0]["action"]
    if outside := np.argwhere((actions < low) | (actions > high)).tolist():
        step, servo = outside[0]
        raise CadenzaError(f"{path}: action {servo} of step {step} is out of the servo's range")
    return actions.astype(np.float64)


def _played(actions: NDArray[np.float64], seed: int, setup: Setup, where: str) -> Metrics:
    """Return the metrics of actions (T, A), played from the beginning to the end of a song."""
    metrics = play_episode(setup.task, Playback(actions), seed).metrics
    if metrics["steps"] != len(actions):
        raise CadenzaError(
            f"{where}: the simulation becomes unstable after {metrics['steps']} of "
            f"{len(actions)} steps"
        )
    return {name: metrics[name] for name in METRICS}


_HIDES_FINGERS = ("robot", "human")  # values of --fingering with which a score's are not seen


def enter(
    bench: Path,
    folder: Path,
    *,
    songs: str,
    track: str,
    about: str,
    by: str,
    agent: str | None = None,
    name: str | None = None,
    progress: Progress = silent,
) -> PlayedAgain:
    """Write an entry of the runs of a bench, and play it again to see that it holds.

    Raises CadenzaError if a run is missing, failed, or was played in another task; or what is said
    of the entry cannot be; or it does not play as it was recorded.

    Args:
        bench: the folder of the bench.
        folder: the folder of the entry, which is not there yet.
        songs, track, about, by: see `BenchmarkEntry`.
        agent: agent of the bench; by default the only one that played these songs.
        name: name of the row; by default that of the agent.
        progress: see `verify`.
    """
    library = open_set(songs)
    deployed = track == DEPLOYMENT
    results = [] if deployed else _results(bench, {song.name for song in library.songs}, agent)
    hidden = not deployed and results[0].job["task"]["fingering"] in _HIDES_FINGERS
    told: tuple[str, Any, dict[str, str]] = AGENT, {}, versions()
    if not deployed:
        told = results[0].agent, results[0].job["config"], results[0].versions
    fingering: Literal["given", "none"] = "none"
    runs = list[EnteredRun]()
    with new_folder(folder) as new:
        for song in library.songs:
            with set_up_song(song) as setup:
                digest, spec = check_frozen(song, setup), setup.task.spec
                if setup.score.has_fingering and not hidden:
                    fingering = "given"
                if deployed:
                    runs += robot_runs(bench, new, digest, setup)
            own = [result for result in results if result.song.name == song.name]
            runs += [_run(r, new, digest, spec.action_low, spec.action_high) for r in own]
        entry = BenchmarkEntry(
            benchmark=VERSION,
            name=name or told[0],
            by=by,
            about=about,
            agent=told[0],
            options=told[1] if isinstance(told[1], dict) else {},
            track=track,
            songs=songs,
            fingering=fingering,
            versions=told[2],
            runs=tuple(runs),
        )
        check_claims(entry)
        write_json(new / ENTRY, asdict(entry))
        played = verify(new, progress)
        if played.differences:
            raise CadenzaError(
                f"{bench}: does not play as it was recorded: {played.differences[0]}; was it "
                "recorded with another version of Cadenza?"
            )
    return played


def _results(bench: Path, songs: set[str], agent: str | None) -> list[Result]:
    """Return the runs of one agent on these songs, all with the same options, in the task."""
    results = [result for result in read_results(bench).results if result.song.name in songs]
    agents = sorted({result.agent for result in results})
    if not agents:
        raise CadenzaError(f"{bench}: nobody has played these songs; do so with cadenza bench")
    if agent is None and len(agents) == 1:
        agent = agents[0]
    if agent not in agents:
        raise CadenzaError(
            f"{bench}: these songs were played by {', '.join(agents)}; name one with --agent"
        )
    results = [result for result in results if result.agent == agent]
    for result in results:
        _check_task(result)
        for what in "config", "agent_digest", "task":
            if not _is_same(result, results[0], what):
                raise CadenzaError(
                    f"{result.folder}: {result.agent} has other options than in other runs; "
                    "give each a bench of its own"
                )
    return results


def _is_same(result: Result, other: Result, what: str) -> bool:
    """Whether two runs agree; what is trained on a song has its own seed and files."""
    own, others = result.job.get(what), other.job.get(what)
    if result.training is not None and isinstance(own, dict) and isinstance(others, dict):
        return {**own, "seed": None} == {**others, "seed": None}
    return own == others or result.agent == "pretrained"


def _check_task(result: Result) -> None:
    """Raise a CadenzaError if a run was played in another task than that of the benchmark."""
    job, where = result.job, result.folder
    task = checked(job.get("task"), TaskConfig, f"{where}, task")
    scene = checked(job.get("scene"), SceneConfig, f"{where}, scene")
    arrangement = checked(job.get("arrangement"), Arrangement, f"{where}, arrangement")
    if task.randomization.is_on:
        raise CadenzaError(f"{where}: was played with randomized physics; leave that out")
    played = task_identity(task, scene, 0, **asdict(arrangement))
    options = task_identity(TASK, SCENE, 0, **asdict(Arrangement()))
    for name, value in options.items():
        if played[name] != value:
            option = name.replace("_", "-")
            raise CadenzaError(
                f"{where}: was played with {option} {played[name]}, but the benchmark has {value}; "
                f"give --{option} {value} to cadenza bench"
            )


def _run(result: Result, folder: Path, digest: str, low: Any, high: Any) -> EnteredRun:
    """Write the actions of a run; servos clip them to their range."""
    actions = load_plan(result.folder / "episode.npz").actions.clip(low, high)
    write_tensors(actions_path(folder, result.song.name, result.seed), {"action": actions})
    return EnteredRun(
        song=result.song.name,
        seed=result.seed,
        song_digest=digest,
        metrics={n: None if (of := result.metrics.get(n)) is None else float(of) for n in METRICS},
        cpu_seconds=result.timing.cpu_seconds,
    )
