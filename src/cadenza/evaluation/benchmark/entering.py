"""An entry made of the runs of a bench."""

from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from cadenza.agents.playback import load_plan
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
from cadenza.evaluation.benchmark.deployment import AGENT, robot_runs
from cadenza.evaluation.benchmark.entry import (
    ENTRY,
    BenchmarkEntry,
    EnteredRun,
    actions_path,
    check_claims,
)
from cadenza.evaluation.benchmark.verification import PlayedAgain, verify
from cadenza.evaluation.results import Result, read_results
from cadenza.evaluation.run import versions
from cadenza.files import checked, new_folder, write_json, write_tensors
from cadenza.music.arrangement import Arrangement
from cadenza.music.libraries.imported import Progress, silent
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig, task_identity

_HIDES_FINGERS = ("robot", "human")  # values of --fingering that hide the score's fingers


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
    """Write an entry of the runs of a bench, and verify it.

    Raises CadenzaError if a run is missing, failed, or was played in another task; if a claim is
    impossible; or if the entry is not verified.

    Args:
        bench: the folder of the bench.
        folder: the folder of the entry, which must not exist.
        songs, track, about, by: see `BenchmarkEntry`.
        agent: agent of the bench; by default the only one that played these songs.
        name: name of the row; by default that of the agent.
        progress: see `verify`.
    """
    library = open_set(songs)
    deployed = track == DEPLOYMENT
    results = [] if deployed else _results(bench, {song.name for song in library.songs}, agent)
    hidden = not deployed and results[0].job["task"]["fingering"] in _HIDES_FINGERS
    agent_name, options, agent_versions = AGENT, {}, versions()
    if not deployed:
        agent_name, agent_versions = results[0].agent, results[0].versions
        options = results[0].job["config"]
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
            of_song = [result for result in results if result.song.name == song.name]
            runs += [_run(r, new, digest, spec.action_low, spec.action_high) for r in of_song]
        entry = BenchmarkEntry(
            benchmark=VERSION,
            name=name or agent_name,
            by=by,
            about=about,
            agent=agent_name,
            options=options if isinstance(options, dict) else {},
            track=track,
            songs=songs,
            fingering=fingering,
            versions=agent_versions,
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
    """The runs of one agent on these songs; raises CadenzaError if they do not fit."""
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
        for name in "config", "agent_digest", "task":
            if not _is_same(result, results[0], name):
                raise CadenzaError(
                    f"{result.folder}: {result.agent} has other options than in other runs; "
                    "give each a bench of its own"
                )
    return results


def _is_same(result: Result, other: Result, name: str) -> bool:
    """Whether a setting of two runs agrees, except for seeds of training and pretrained files."""
    value, other_value = result.job.get(name), other.job.get(name)
    if result.training is not None and isinstance(value, dict) and isinstance(other_value, dict):
        return {**value, "seed": None} == {**other_value, "seed": None}
    return value == other_value or result.agent == "pretrained"


def _check_task(result: Result) -> None:
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
    """Write the actions of a run, clipped as the servos do."""
    actions = load_plan(result.folder / "episode.npz").actions.clip(low, high)
    write_tensors(actions_path(folder, result.song.name, result.seed), {"action": actions})
    return EnteredRun(
        song=result.song.name,
        seed=result.seed,
        song_digest=digest,
        metrics={n: None if (of := result.metrics.get(n)) is None else float(of) for n in METRICS},
        cpu_seconds=result.timing.cpu_seconds,
    )
