"""The status of a run, which the process that carries it out keeps in the run's folder.

FOLDER/log.txt          output of the process
FOLDER/progress.json    how far it is
FOLDER/failed.json      why there is no result
FOLDER/lock             held by the process
"""

import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from cadenza.agents.agent import Progress
from cadenza.errors import CadenzaError, in_a_line
from cadenza.evaluation.jobs import BenchJob, JobSpec, song_digest
from cadenza.evaluation.results import FAILED, FORMAT
from cadenza.files import read_json, write_json
from cadenza.music.libraries.library import find_song
from cadenza.resumable import ResumableFolder, installed_versions

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
