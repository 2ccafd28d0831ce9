"""Carries out one run: from a job to the files of its folder.

NAME/job.json         what the run is
NAME/progress.json    how far it is
NAME/log.txt          what was said meanwhile
NAME/training/        the run of training, of a policy that is trained first
NAME/episode.npz      and the other files of `cadenza play`, report.html where a page is wanted
NAME/result.json      how well it went; written last, so that a run with it is finished
NAME/failed.json      or why there is none
NAME/lock             held by the process at work

A run that is killed leaves no result. Carried out again, a performance begins anew, and training
goes on from its last checkpoint. If a page is wanted of a run that was finished without one, it is
made from these files.
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from filelock import FileLock, Timeout

from cadenza.agents.agent import Progress
from cadenza.errors import CadenzaError
from cadenza.evaluation.job import Job, JobSpec
from cadenza.evaluation.results import (
    FAILED,
    FORMAT,
    PAGE,
    RESULT,
    ResultFile,
    Timing,
    Trained,
)
from cadenza.evaluation.songs import digest_of
from cadenza.files import TEMPORARY, parsed_json, read_json, write_json
from cadenza.learning.config import TrainingConfig
from cadenza.learning.cores import claimed_cores
from cadenza.learning.run_folder import RunFolder
from cadenza.music.libraries.library import find_song
from cadenza.performing.performance import Performance, add_page, perform
from cadenza.performing.setup import select, set_up

_PATIENCE = 2.0  # [s] for which a run waits for one that may just be ending
_BETWEEN = 1.0  # [s] at least between two writings of how far it is
_PROGRESS = "progress.json"
_VERSIONS = ("cadenza", "mujoco", "numpy")


@dataclass(frozen=True)
class At:
    """How far a run is."""

    stage: str
    done: int
    total: int
    host: str
    pid: int


@contextmanager
def locked(folder: Path, patience: float = 0.0) -> Iterator[bool]:
    """Whether this process has the run to itself for the block."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / "lock")
    try:
        lock.acquire(timeout=patience)
    except Timeout:
        yield False
        return
    try:
        yield True
    finally:
        lock.release()


def carry_out(
    job: Job, folder: Path, num_threads: int, stop: Callable[[], bool] = lambda: False
) -> None:
    """Leaves a result, or why there is none, in `folder`; nothing where another process is at it.

    Of a run that is finished, leaves the page if one is wanted.

    Args:
        job: what to run.
        folder: of the run.
        num_threads: that a planner or training may use.
        stop: is asked now and then whether training is to end, with a checkpoint to go on from.
    """
    with locked(folder, _PATIENCE) as ours:
        if not ours or is_complete(job, folder):
            return
        _tidy(folder)
        with _logged(folder / "log.txt"):
            if (folder / RESULT).exists():
                _add_page(job.spec, folder)
            else:
                _carry_out(job, folder, num_threads, stop)
        (folder / _PROGRESS).unlink(missing_ok=True)


def is_complete(job: Job, folder: Path) -> bool:
    """Whether the run is finished, and has the page that is wanted."""
    return (folder / RESULT).exists() and (not job.page or (folder / PAGE).exists())


def _carry_out(job: Job, folder: Path, num_threads: int, stop: Callable[[], bool]) -> None:
    write_json(folder / "job.json", job.spec.as_json())
    try:
        result = _result(job, folder, num_threads, stop)
    except Exception as error:
        traceback.print_exc()
        write_failure(folder, _in_a_line(error))
    else:
        if result is not None:
            write_json(folder / RESULT, asdict(result))
            _drop_checkpoints(folder / "training")


def _add_page(spec: JobSpec, folder: Path) -> None:
    """Of a run that is finished; one of which none can be made keeps its result."""
    try:
        result = read_json(folder / RESULT, ResultFile)
        write_json(folder / RESULT, asdict(replace(result, pages={"report": PAGE})))
        _check_song(spec)
        selection = select(spec.song, "zero", arrangement=spec.arrangement)
        with set_up(selection, spec.task, spec.scene, spec.seed) as setup:
            goal = perform(setup, stop=lambda: True).goal  # of its first step
        add_page(folder, goal)
    except Exception:
        traceback.print_exc()


def write_failure(folder: Path, error: str) -> None:
    """Says why the run has no result."""
    write_json(folder / FAILED, {"format": FORMAT, "error": error})


def progress_of(folder: Path) -> At | None:
    """How far the run is; None if that cannot be told now."""
    with suppress(CadenzaError, OSError):
        return parsed_json((folder / _PROGRESS).read_bytes(), At, folder)
    return None


def _tidy(folder: Path) -> None:
    """Removes what a run before this one has left."""
    (folder / FAILED).unlink(missing_ok=True)
    for half_written in folder.glob(f"{TEMPORARY}*"):
        half_written.unlink(missing_ok=True)


def _in_a_line(error: Exception) -> str:
    """What went wrong; where too, if it was not what somebody has given."""
    said = " ".join(str(error).split())
    if isinstance(error, CadenzaError | OSError):
        return said
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {said} ({frame.filename}, line {frame.lineno})"


@contextmanager
def _logged(path: Path) -> Iterator[None]:
    """What this process and its libraries say in the block goes to the end of a file."""
    streams = sys.stdout, sys.stderr
    kept = [os.dup(fd) for fd in (1, 2)]
    try:
        with open(path, "a", buffering=1, errors="backslashreplace") as log:
            for fd in (1, 2):
                os.dup2(log.fileno(), fd)
            sys.stdout = sys.stderr = log
            yield
    finally:
        sys.stdout, sys.stderr = streams
        for fd, before in zip((1, 2), kept, strict=True):
            os.dup2(before, fd)
            os.close(before)


def _telling(folder: Path) -> Progress:
    """Writes how far the run is, now and then, for whoever watches."""
    host, last = platform.node(), -_BETWEEN

    def tell(stage: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last < _BETWEEN:
            return
        last = time.monotonic()
        at = At(stage, int(done), int(total), host, os.getpid())
        write_json(folder / _PROGRESS, asdict(at))

    return tell


def _result(
    job: Job, folder: Path, num_threads: int, stop: Callable[[], bool]
) -> ResultFile | None:
    """Of a run that comes to its end; None where it is stopped before."""
    spec, tell = job.spec, _telling(folder)
    tell("beginning", 0, 0)
    _check_song(spec)
    began, cpu_before, trained = time.perf_counter(), time.process_time(), None
    if spec.training is not None:
        trained = _train(spec, spec.training, folder / "training", num_threads, tell, stop)
        if trained is None:
            return None
    performance = _play(spec, folder, num_threads, tell)
    if trained is None:
        seconds, cpu_seconds = time.perf_counter() - began, time.process_time() - cpu_before
    else:
        seconds, cpu_seconds = trained.seconds, None
    performance.save(folder, progress=tell, page=job.page)
    return ResultFile(
        format=FORMAT,
        job=spec.as_json(),
        song=replace(job.song, notes=len(performance.score.notes)),
        metrics=performance.metrics | {"energy": performance.energy},
        timing=Timing(seconds, performance.seconds, num_threads, cpu_seconds),
        versions=_versions(),
        pages={"report": PAGE if job.page else None},
        training=trained,
    )


def _check_song(spec: JobSpec) -> None:
    if digest_of(find_song(spec.song)) != spec.song_digest:
        raise CadenzaError(
            f"{spec.song}: has other notes here and now than when the run was planned; "
            "use the same files everywhere, and run the command again"
        )


def _play(spec: JobSpec, folder: Path, num_threads: int, tell: Progress) -> Performance:
    agent = spec.agent if spec.training is None else str(folder / "training" / "best")
    configs = {} if spec.training is not None else {spec.agent: spec.config}
    selection = select(spec.song, agent, arrangement=spec.arrangement, configs=configs)
    with set_up(selection, spec.task, spec.scene, spec.seed, tell, num_threads) as setup:
        return perform(setup, tell)


def _train(
    spec: JobSpec,
    config: TrainingConfig,
    folder: Path,
    num_threads: int,
    tell: Progress,
    stop: Callable[[], bool],
) -> Trained | None:
    """Trains a policy, or goes on with that; None where it is stopped before the end."""
    from cadenza.learning.training import Training  # heavy

    run = RunFolder(folder)
    with claimed_cores(num_threads), run.locked():
        if not run.begun:
            run.begin(config, spec.arrangement.score(spec.song))
        config, score = run.settings()
        with closing(Training(config, score, run)) as training:

            def goes_on() -> bool:
                training.rows.clear()  # they are in the folder
                tell("learning", training.step, config.num_steps)
                return not stop()

            training.run(goes_on)
            if training.step < config.num_steps:
                return None
        return Trained(config.num_steps, run.rows()[-1]["seconds"])


def _drop_checkpoints(training: Path) -> None:
    """Of a run that is finished, which needs them no more: they are most of what it wrote."""
    for name in ("checkpoints", "replay"):
        shutil.rmtree(training / name, ignore_errors=True)


def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    for package in _VERSIONS:
        with suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions
