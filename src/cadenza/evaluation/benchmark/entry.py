"""Makes an entry of the runs of a bench."""

from __future__ import annotations

import math
import platform
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

from cadenza.agents.playback import load_plan
from cadenza.errors import CadenzaError
from cadenza.evaluation.benchmark.about import About
from cadenza.evaluation.benchmark.card import (
    CARD,
    FORMAT,
    Card,
    Effort,
    RecordedRun,
    actions_digest,
    actions_path,
    check_track,
)
from cadenza.evaluation.benchmark.definition import (
    METRICS,
    SCENE,
    TASK,
    VERSION,
    check_frozen,
    open_set,
    set_up_song,
)
from cadenza.evaluation.benchmark.verification import Verified, engine, verify
from cadenza.evaluation.results import Result, read_results
from cadenza.files import checked, new_folder, write_json, write_tensors
from cadenza.music.arrangement import Arrangement
from cadenza.music.libraries.imported import Progress, silent
from cadenza.scene.config import SceneConfig
from cadenza.tasks.config import TaskConfig, task_identity

_HIDES_FINGERS = ("robot", "human")  # values of --fingering with which a score's are not seen
_SECONDS_PER_HOUR = 3600


def enter(bench: Path, entry: Path, about: About, progress: Progress = silent) -> Verified:
    """Writes an entry of the runs of a bench, and plays it again to see that it holds.

    Args:
        bench: the folder of the bench.
        entry: the folder of the entry, which is not there yet.
        about: what the runs cannot tell.
        progress: see `verify`.

    Raises:
        CadenzaError: a run is missing, failed, or was played in another task; or what is said of
            the entry cannot be; or it does not play as it was recorded.
    """
    library = open_set(about.songs)
    results = _results(bench, {song.name for song in library.songs}, about.agent)
    first = results[0]
    effort = _effort(results, about)
    options = first.job["config"] if isinstance(first.job["config"], dict) else {}
    check_track(about.track, first.agent, options, about.songs, effort)
    hidden = first.job["task"]["fingering"] in _HIDES_FINGERS
    given, runs = False, list[RecordedRun]()
    with new_folder(entry) as folder:
        for song in library.songs:
            own = [result for result in results if result.song.name == song.name]
            with set_up_song(song) as setup:
                digest, spec = check_frozen(song, setup), setup.task.spec
                given |= setup.score.has_fingering and not hidden
            for result in own:
                runs.append(_recorded(result, folder, digest, spec.action_low, spec.action_high))
        fingering: Literal["given", "none"] = "given" if given else "none"
        card = Card(
            format=FORMAT,
            benchmark=VERSION,
            name=about.name or first.agent,
            by=about.by,
            agent=first.agent,
            options=options,
            track=about.track,
            songs=about.songs,
            fingering=fingering,
            seeds=tuple(sorted({result.seed for result in results})),
            data=about.data,
            hardware=about.hardware or _processor(),
            versions=first.versions | engine(),
            runs=tuple(runs),
            effort=effort,
        )
        write_json(folder / CARD, asdict(card))
        verified = verify(folder, progress)
        if verified.problems:
            raise CadenzaError(
                f"{bench}: does not play as it was recorded: {verified.problems[0]}; was it "
                "recorded with another version of Cadenza?"
            )
    return verified


def _results(bench: Path, songs: set[str], agent: str | None) -> list[Result]:
    """Returns the runs of one agent on these songs, all with the same options, in the task."""
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
    mine, theirs = result.job.get(what), other.job.get(what)
    if result.training is not None and isinstance(mine, dict) and isinstance(theirs, dict):
        return {**mine, "seed": None} == {**theirs, "seed": None}
    return mine == theirs or result.agent == "pretrained"


def _check_task(result: Result) -> None:
    """Raises a CadenzaError if a run was played in another task than that of the benchmark."""
    job, where = result.job, result.folder
    task = checked(job.get("task"), TaskConfig, f"{where}, task")
    scene = checked(job.get("scene"), SceneConfig, f"{where}, scene")
    arrangement = checked(job.get("arrangement"), Arrangement, f"{where}, arrangement")
    if task.randomization.is_on:
        raise CadenzaError(f"{where}: was played with randomized physics; leave that out")
    played = task_identity(task, scene, 0, **asdict(arrangement))
    wanted = task_identity(TASK, SCENE, 0, **asdict(Arrangement()))
    for name, value in wanted.items():
        if played[name] != value:
            option = name.replace("_", "-")
            raise CadenzaError(
                f"{where}: was played with {option} {played[name]}, but the benchmark has {value}; "
                f"give --{option} {value} to cadenza bench"
            )


def _effort(results: Sequence[Result], about: About) -> Effort:
    """Returns what was spent on training: as measured where a bench has trained, else as said."""
    trained = [result for result in results if result.training is not None]
    if not trained:
        return Effort(about.training_steps, about.cpu_hours, about.gpu_hours)
    steps = sum(result.training.steps for result in trained if result.training)
    core_seconds = math.fsum(r.training.seconds * r.timing.threads for r in trained if r.training)
    return Effort(steps, round(core_seconds / _SECONDS_PER_HOUR, 3), about.gpu_hours)


def _processor() -> str:
    """Returns the name of the processor, as Linux says it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.machine()


def _recorded(result: Result, folder: Path, digest: str, low: Any, high: Any) -> RecordedRun:
    """Writes the actions of a run; servos take no more than their range, whatever they are told."""
    actions = load_plan(result.folder / "episode.npz").actions.clip(low, high)
    write_tensors(actions_path(folder, result.song.name, result.seed), {"action": actions})
    metrics = {name: _number(result.metrics.get(name)) for name in METRICS}
    return RecordedRun(
        song=result.song.name,
        seed=result.seed,
        song_digest=digest,
        steps=len(actions),
        actions=actions_digest(actions),
        metrics=metrics,
        wall_seconds=result.timing.wall_seconds,
        cpu_seconds=result.timing.cpu_seconds,
    )


def _number(value: Any) -> float | None:
    return None if value is None else float(value)
