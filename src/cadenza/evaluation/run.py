"""Carries out one run: from a job to the files of its folder.

NAME/job.json         what the run is
NAME/training/        the run of training, of a policy that is trained first
NAME/episode.npz      and the other files of `cadenza play`, report.html where a page is wanted
NAME/result.json      how well it went; written last, so that a run with it is finished
NAME/failed.json      or why there is none
NAME/log.txt          output of the process
NAME/progress.json    how far it is
NAME/lock             held by the process

A run that is killed leaves no result. Carried out again, a performance begins anew, and training
goes on from its last checkpoint.
"""

import os
import platform
import shutil
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from cadenza.agents.agent import Progress
from cadenza.errors import CadenzaError, in_a_line
from cadenza.evaluation.jobs import BenchJob, JobSpec, song_digest
from cadenza.evaluation.results import (
    FAILED,
    FORMAT,
    RESULT,
    ResultFile,
    Timing,
    Trained,
    is_finished,
)
from cadenza.files import read_json, write_json
from cadenza.learning.config import TrainingConfig
from cadenza.learning.cpu_affinity import claimed_cores
from cadenza.learning.run_folder import RunFolder
from cadenza.music.arrangement import load
from cadenza.music.libraries.library import find_song
from cadenza.performing.performance import perform
from cadenza.performing.setup import find_player, set_up
from cadenza.resumable import ResumableFolder, installed_versions
from cadenza.sim.threads import cpu_seconds

_LOCK_TIMEOUT = 2.0  # [s] for which a run waits for one that may just be ending
_PROGRESS_INTERVAL = 1.0  # [s] at least between two writings of the progress
_PROGRESS = "progress.json"
_VERSIONS = ("cadenza", "mujoco", "numpy")


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run."""

    stage: str
    done: int
    total: int
    pid: int


def folder_of(job: BenchJob, path: Path) -> ResumableFolder:
    """Return the folder of a run, whose name has the hash of what its manifest says."""
    return ResumableFolder(path, job.command, "another process carries it out", "job.json")


@contextmanager
def claimed_run(job: Any, path: Path, is_complete: Callable[[Any, Path], bool]) -> Iterator[bool]:
    """Yield whether this process is to carry out a run, whose output goes to its log meanwhile.

    It is not to where another process does, or where the run `is_complete`. An error of the block
    is recorded as the reason why the run has no result.
    """
    folder = folder_of(job, path)
    with folder.claimed(_LOCK_TIMEOUT) as ours:
        if not ours or is_complete(job, path):
            yield False
            return
        folder.write_manifest(job.spec.as_json())
        (path / FAILED).unlink(missing_ok=True)
        with _output_to(path / "log.txt"):
            try:
                yield True
            except Exception as error:
                traceback.print_exc()
                write_failure(path, in_a_line(error))
        (path / _PROGRESS).unlink(missing_ok=True)


def write_failure(folder: Path, error: str) -> None:
    """Record why the run has no result."""
    write_json(folder / FAILED, {"format": FORMAT, "error": error})


def read_progress(folder: Path) -> RunProgress | None:
    """Return how far the run is; None if that cannot be read now."""
    with suppress(CadenzaError):
        return read_json(folder / _PROGRESS, RunProgress)
    return None


@contextmanager
def _output_to(path: Path) -> Iterator[None]:
    """Append the output of this process and its libraries in the block to a file."""
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


def progress_writer(folder: Path) -> Progress:
    """Return what writes how far the run is, now and then, for whoever watches."""
    last = -_PROGRESS_INTERVAL

    def write(stage: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last < _PROGRESS_INTERVAL:
            return
        last = time.monotonic()
        progress = RunProgress(stage, int(done), int(total), os.getpid())
        write_json(folder / _PROGRESS, asdict(progress))

    return write


def check_song(spec: JobSpec) -> None:
    """Compare the song with the planned one; raises CadenzaError if it has changed since."""
    if song_digest(find_song(spec.song)) != spec.song_digest:
        raise CadenzaError(
            f"{spec.song}: has other notes here and now than when the run was planned; "
            "use the same files everywhere, and run the command again"
        )


def versions() -> dict[str, str]:
    """Return the versions of the programs that a result depends on."""
    python = {"python": platform.python_version(), "platform": platform.platform()}
    return python | installed_versions(_VERSIONS)


def carry_out(
    job: BenchJob, folder: Path, num_threads: int, stop: Callable[[], bool] = lambda: False
) -> None:
    """Leave a result, or why there is none, in `folder`, unless another process works on it.

    `stop` is asked now and then whether training is to end, with a checkpoint.
    """
    with claimed_run(job, folder, is_finished) as ours:
        if ours and (result := _result(job, folder, num_threads, stop)) is not None:
            write_json(folder / RESULT, asdict(result))
            training = RunFolder(folder / "training")
            training.checkpoint.unlink(missing_ok=True)
            shutil.rmtree(training.replay, ignore_errors=True)  # most of what training wrote


def _result(
    job: BenchJob, folder: Path, num_threads: int, stop: Callable[[], bool]
) -> ResultFile | None:
    """Play, after training if asked to; return None where it is stopped."""
    spec, progress = job.spec, progress_writer(folder)
    progress("beginning", 0, 0)
    check_song(spec)
    began, cpu_before, trained = time.perf_counter(), cpu_seconds(), None
    if spec.training is not None:
        trained = _train(spec, spec.training, folder / "training", num_threads, progress, stop)
        if trained is None:
            return None
    agent = spec.agent if trained is None else str(folder / "training" / "best")
    configs = {spec.agent: spec.config} if trained is None else {}
    with set_up(
        spec.song,
        find_player(agent, spec.song, configs=configs).playing_in(spec.task, spec.scene),
        arrangement=spec.arrangement,
        seed=spec.seed,
        num_threads=num_threads,
        progress=progress,
    ) as setup:
        performance = perform(setup, progress)
    if trained is None:
        seconds, cpu = time.perf_counter() - began, cpu_seconds() - cpu_before
    else:
        seconds, cpu = trained.seconds, None
    performance.save(folder, progress=progress, page=job.page)
    return ResultFile(
        format=FORMAT,
        job=spec.as_json(),
        song=replace(job.song, notes=len(performance.score.notes)),
        metrics=performance.metrics,
        timing=Timing(seconds, performance.seconds, num_threads, cpu),
        versions=versions(),
        training=trained,
    )


def _train(
    spec: JobSpec,
    config: TrainingConfig,
    folder: Path,
    num_threads: int,
    progress: Progress,
    stop: Callable[[], bool],
) -> Trained | None:
    """Train a policy, or resume its training; return None where it is stopped before the end."""
    from cadenza.learning.problem import problem_of  # heavy
    from cadenza.learning.training import Training

    run = RunFolder(folder)
    with claimed_cores(num_threads), run.locked():
        if not run.begun:
            song = load(spec.song, spec.arrangement).written_for(config.scene.hands)
            run.begin(config, [song.score])
        config, scores = run.settings()
        with closing(Training(problem_of(config, scores), run)) as training:

            def should_continue() -> bool:
                progress("learning", training.step, config.num_steps)
                return not stop()

            training.run(should_continue)
            if training.step < config.num_steps:
                return None
        return Trained(config.num_steps, run.metrics.rows()[-1]["seconds"])
