"""The lock, the log, the progress and the failure of a run in its folder."""

import os
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
from cadenza.evaluation.jobs import BenchJob
from cadenza.evaluation.results import FAILED, FORMAT
from cadenza.files import read_json, write_json
from cadenza.resumable import ResumableFolder

_LOCK_TIMEOUT = 2.0  # [s] for which a run waits for one that may just be ending
_PROGRESS_INTERVAL = 1.0  # minimum time between two writings of the progress [s]
_PROGRESS = "progress.json"


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run."""

    stage: str
    done: int
    total: int
    pid: int


def folder_of(job: BenchJob, path: Path) -> ResumableFolder:
    """The folder of a run, whose name has the hash of its manifest."""
    return ResumableFolder(path, job.command, "another process carries it out", "job.json")


@contextmanager
def claimed_run(job: Any, path: Path, is_complete: Callable[[Any, Path], bool]) -> Iterator[bool]:
    """Yield whether this process is to carry out a run: unless it is complete, or another one does.

    Within the block, output goes to the log of the run. An error is recorded as the reason why the
    run has no result.
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
    """The progress of the run; None if it cannot be read now."""
    with suppress(CadenzaError):
        return read_json(folder / _PROGRESS, RunProgress)
    return None


@contextmanager
def _output_to(path: Path) -> Iterator[None]:
    """Append the output of this process and its libraries in the block to a file."""
    streams = sys.stdout, sys.stderr
    copies = [os.dup(fd) for fd in (1, 2)]
    try:
        with open(path, "a", buffering=1, errors="backslashreplace") as log:
            for fd in (1, 2):
                os.dup2(log.fileno(), fd)
            sys.stdout = sys.stderr = log
            yield
    finally:
        sys.stdout, sys.stderr = streams
        for fd, before in zip((1, 2), copies, strict=True):
            os.dup2(before, fd)
            os.close(before)


def progress_writer(folder: Path) -> Progress:
    """A function that writes the progress of the run now and then."""
    last = -_PROGRESS_INTERVAL

    def write(stage: str, done: int, total: int) -> None:
        nonlocal last
        if time.monotonic() - last < _PROGRESS_INTERVAL:
            return
        last = time.monotonic()
        progress = RunProgress(stage, int(done), int(total), os.getpid())
        write_json(folder / _PROGRESS, asdict(progress))

    return write
