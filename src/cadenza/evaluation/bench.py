"""Carries out many runs, as many at once as an executor has room for."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from cadenza.errors import CadenzaError
from cadenza.evaluation.at_work import write_failure
from cadenza.evaluation.job import Job
from cadenza.evaluation.results import FAILED, RESULT, RUNS, failure
from cadenza.evaluation.run import is_complete
from cadenza.files import locked

_BETWEEN_LOOKS = 0.5  # [s]
_ATTEMPTS = 3  # at a run whose process dies


CarryOut = Callable[[Any, Path, int, Callable[[], bool]], None]
"""Carries out a job, see `cadenza.evaluation.run.carry_out`."""


class Ended(NamedTuple):
    """A run whose process has ended."""

    job: Job
    crash: str = ""
    """What became of a process that died, in a line; others leave a result or why there is none."""


class Executor(Protocol):
    """Where runs are carried out, each by a process of its own."""

    @property
    def capacity(self) -> int:
        """How many runs at once."""

    def start(self, job: Job, folder: Path) -> None:
        """Begins what the executor was made for, such as `cadenza.evaluation.run.carry_out`."""

    def ended(self, seconds: float) -> list[Ended]:
        """Waits at most so long [s] for some to end."""

    def stop(self) -> None:
        """Ends all runs under way, so that they can be taken up again."""

    def close(self) -> None:
        """Lets go of all that it needed."""


@dataclass
class State:
    """How far a bench is. Runs are named as their folders."""

    folder: Path
    """Of all runs."""
    total: int
    is_complete: Callable[[Any, Path], bool] = is_complete
    """Whether nothing is left to do for a run in its folder."""
    todo: deque[Job] = field(default_factory=deque)
    running: dict[str, Job] = field(default_factory=dict)
    elsewhere: list[Job] = field(default_factory=list)
    """Which another process has been found at work on."""
    finished: int = 0
    failed: dict[str, str] = field(default_factory=dict)
    """With why."""
    died: dict[str, list[str]] = field(default_factory=dict)
    """What became of each process that died."""

    @property
    def left(self) -> int:
        """Neither finished nor failed."""
        return self.total - self.finished - len(self.failed)


def bench(
    jobs: Sequence[Job],
    folder: Path,
    executor: Executor,
    ended: Callable[[State, Job], None],
    goes_on: Callable[[State], bool],
    retry: bool = False,
    is_complete: Callable[[Any, Path], bool] = is_complete,
) -> State:
    """Carries out what is not complete yet.

    Args:
        jobs: all runs that there are to be.
        folder: of the bench.
        executor: where they are carried out.
        ended: is told of a run that has finished or failed, or whose process has died and which is
            to be taken up again.
        goes_on: is asked now and then; where it is false, all ends that is under way.
        retry: runs that have failed before are carried out again.
        is_complete: whether nothing is left to do for a run in its folder.
    """
    state = State(folder / RUNS, len(jobs), is_complete)
    for job in jobs:
        if is_complete(job, state.folder / job.spec.name):
            state.finished += 1
        elif retry or not _has_failed(state, job):
            state.todo.append(job)
    while state.todo or state.running or state.elsewhere:
        if not goes_on(state):
            executor.stop()
            for job in state.running.values():
                _is_finished(state, job, "stopped")  # before it was
            break
        while state.todo and len(state.running) < executor.capacity:
            _start(state, state.todo.popleft(), executor)
        if not state.running:
            time.sleep(_BETWEEN_LOOKS)
        for job, crash in executor.ended(_BETWEEN_LOOKS) if state.running else ():
            del state.running[job.spec.name]
            if _is_ours(state, job, crash):
                ended(state, job)
            else:
                state.elsewhere.append(job)
        _look_elsewhere(state, ended)
    return state


def _start(state: State, job: Job, executor: Executor) -> None:
    state.running[job.spec.name] = job
    executor.start(job, state.folder / job.spec.name)


def _is_finished(state: State, job: Job, crash: str = "") -> bool:
    """Whether a run has ended well; what an earlier attempt has left may not be good enough."""
    folder = state.folder / job.spec.name
    pageless = job.page and not crash and (folder / RESULT).exists()  # as none can be made of it
    ended = state.is_complete(job, folder) or pageless
    finished = ended and not (folder / FAILED).exists()
    state.finished += finished
    return finished


def _has_failed(state: State, job: Job) -> bool:
    try:
        why = failure(state.folder / job.spec.name)
    except CadenzaError as error:  # what it says is corrupt
        why = str(error)
    if why is not None:
        state.failed[job.spec.name] = why
    return why is not None


def _is_ours(state: State, job: Job, crash: str) -> bool:
    """Whether a run whose process has ended is ours to tell of; else another is at work on it."""
    name, folder = job.spec.name, state.folder / job.spec.name
    if _is_finished(state, job, crash):
        return True
    with locked(folder) as ours:
        if not ours:
            return False
        if crash or not (folder / FAILED).exists():
            why = crash or "its process ended without a result; see log.txt"
            died = state.died.setdefault(name, [])
            died.append(why)
            if len(died) < _ATTEMPTS:
                state.todo.append(job)  # after all others: there may be more memory then
                return True
            write_failure(folder, f"{why}; so it went {_ATTEMPTS} times")
    _has_failed(state, job)
    return True


def _look_elsewhere(state: State, ended: Callable[[State, Job], None]) -> None:
    """Takes up runs that others have given up."""
    waiting, state.elsewhere = state.elsewhere, []
    for job in waiting:
        with locked(state.folder / job.spec.name) as ours:
            pass
        if _is_finished(state, job) or (ours and _has_failed(state, job)):
            ended(state, job)
        elif ours:
            state.todo.append(job)
        else:
            state.elsewhere.append(job)
