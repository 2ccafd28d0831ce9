"""A process at work on a run: it has the folder to itself, and leaves a log and how far it is.

FOLDER/log.txt          what was said meanwhile
FOLDER/progress.json    how far it is
FOLDER/failed.json      why there is no result
FOLDER/lock             held by the process at work
"""

from __future__ import annotations

import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from cadenza.agents.agent import Progress
from cadenza.errors import CadenzaError, explained, lacks_memory
from cadenza.evaluation.job import JobSpec
from cadenza.evaluation.results import FAILED, FORMAT
from cadenza.evaluation.songs import digest_of
from cadenza.files import TEMPORARY, locked, read_json, write_json
from cadenza.music.libraries.library import find_song

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
def taken_up(folder: Path, is_complete: Callable[[], bool]) -> Iterator[bool]:
    """Whether this process is to carry out the run in the block; what it says goes to the log.

    It is not where another process is at it, or where it `is_complete`.
    """
    with locked(folder, _PATIENCE) as ours:
        if not ours or is_complete():
            yield False
            return
        _tidy(folder)
        with _logged(folder / "log.txt"):
            yield True
        (folder / _PROGRESS).unlink(missing_ok=True)


@contextmanager
def failures_told(folder: Path) -> Iterator[None]:
    """An error of the block is why the run has no result."""
    try:
        yield
    except Exception as error:
        traceback.print_exc()
        write_failure(folder, _what_failed(error))


def write_failure(folder: Path, error: str) -> None:
    """Says why the run has no result."""
    write_json(folder / FAILED, {"format": FORMAT, "error": error})


def progress_of(folder: Path) -> At | None:
    """How far the run is; None if that cannot be told now."""
    with suppress(CadenzaError):
        return read_json(folder / _PROGRESS, At)
    return None


def _tidy(folder: Path) -> None:
    """Removes what a run before this one has left."""
    (folder / FAILED).unlink(missing_ok=True)
    for half_written in folder.glob(f"{TEMPORARY}*"):
        half_written.unlink(missing_ok=True)


def _what_failed(error: Exception) -> str:
    """What went wrong, in a line; where too, if it was not what somebody has given."""
    if isinstance(error, CadenzaError | OSError) or lacks_memory(error):
        return " ".join(explained(error).split())
    said = " ".join(str(error).split())
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


def telling(folder: Path) -> Progress:
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


def check_song(spec: JobSpec) -> None:
    """Raises: CadenzaError: the song has changed since the run was planned."""
    if digest_of(find_song(spec.song)) != spec.song_digest:
        raise CadenzaError(
            f"{spec.song}: has other notes here and now than when the run was planned; "
            "use the same files everywhere, and run the command again"
        )


def versions() -> dict[str, str]:
    """Of what a result depends on."""
    found = {"python": platform.python_version(), "platform": platform.platform()}
    for package in _VERSIONS:
        with suppress(PackageNotFoundError):
            found[package] = version(package)
    return found
