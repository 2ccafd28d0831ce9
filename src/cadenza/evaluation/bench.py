"""The runs of a bench, carried out by processes, and tried again if a process dies."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.evaluation.jobs import BenchJob
from cadenza.evaluation.processes import ProcessExecutor
from cadenza.evaluation.results import FAILED, RUNS, failure, is_finished
from cadenza.evaluation.run_status import folder_of, write_failure

_POLL_INTERVAL = 0.5  # [s]
_MAX_ATTEMPTS = 3  # at a run whose process dies


@dataclass
class BenchState:
    """State of a bench; runs have the names of their folders."""

    folder: Path  # the folder of all runs
    total: int
    # Whether a run in its folder needs no more work
    is_complete: Callable[[Any, Path], bool] = is_finished
    todo: deque[BenchJob] = field(default_factory=deque)
    running: dict[str, BenchJob] = field(default_factory=dict)
    elsewhere: list[BenchJob] = field(default_factory=list)  # runs that another process works on
    finished: int = 0
    failed: dict[str, str] = field(default_factory=dict)  # reasons of the runs that failed
    # Causes of death of the processes of each run
    died: dict[str, list[str]] = field(default_factory=dict)

    @property
    def done(self) -> int:
        """The number of runs that are finished or have failed."""
        return self.finished + len(self.failed)

    @property
    def left(self) -> int:
        """The number of all other runs."""
        return self.total - self.done


def bench(
    jobs: Sequence[BenchJob],
    folder: Path,
    executor: ProcessExecutor,
    ended: Callable[[BenchState, BenchJob], None],
    should_continue: Callable[[BenchState], bool],
    retry: bool = False,
    is_complete: Callable[[Any, Path], bool] = is_finished,
) -> BenchState:
    """Carry out all incomplete runs; those that have failed before only with `retry`.

    `ended` is called with each run that has finished or failed, or is tried again after its process
    has died. `should_continue` is polled; once it returns False, all runs are stopped.
    """
    state = BenchState(folder / RUNS, len(jobs), is_complete)
    for job in jobs:
        if is_complete(job, state.folder / job.spec.name):
            state.finished += 1
        elif retry or not _has_failed(state, job):
            state.todo.append(job)
    while state.todo or state.running or state.elsewhere:
        if not should_continue(state):
            executor.stop()
            for job in state.running.values():
                _is_finished(state, job)  # counts runs that ended before they were stopped
            break
        while state.todo and len(state.running) < executor.capacity:
            job = state.todo.popleft()
            state.running[job.spec.name] = job
            executor.start(job, state.folder / job.spec.name)
        if not state.running:
            time.sleep(_POLL_INTERVAL)
        for job, crash in executor.ended(_POLL_INTERVAL) if state.running else ():
            del state.running[job.spec.name]
            if _process_ended(state, job, crash):
                ended(state, job)
            else:
                state.elsewhere.append(job)
        _poll_elsewhere(state, ended)
    return state


def _is_finished(state: BenchState, job: BenchJob) -> bool:
    """Whether a run has ended well, and count it if it has."""
    folder = state.folder / job.spec.name
    finished = state.is_complete(job, folder) and not (folder / FAILED).exists()
    state.finished += finished
    return finished


def _has_failed(state: BenchState, job: BenchJob) -> bool:
    try:
        reason = failure(state.folder / job.spec.name)
    except CadenzaError as error:  # the file is corrupt
        reason = str(error)
    if reason is not None:
        state.failed[job.spec.name] = reason
    return reason is not None


def _process_ended(state: BenchState, job: BenchJob, crash: str) -> bool:
    """Record the end of a run; return False if another process works on it."""
    name, folder = job.spec.name, state.folder / job.spec.name
    if _is_finished(state, job):
        return True
    with folder_of(job, folder).claimed() as ours:
        if not ours:
            return False
        if crash or not (folder / FAILED).exists():
            cause = crash or "its process ended without a result; see log.txt"
            causes = state.died.setdefault(name, [])
            causes.append(cause)
            if len(causes) < _MAX_ATTEMPTS:
                state.todo.append(job)  # after all others: there may be more memory then
                return True
            write_failure(folder, f"{cause}; so it went {_MAX_ATTEMPTS} times")
    _has_failed(state, job)
    return True


def _poll_elsewhere(state: BenchState, ended: Callable[[BenchState, BenchJob], None]) -> None:
    """Take over runs that other processes have given up."""
    waiting, state.elsewhere = state.elsewhere, []
    for job in waiting:
        with folder_of(job, state.folder / job.spec.name).claimed() as ours:
            pass
        if _is_finished(state, job) or (ours and _has_failed(state, job)):
            ended(state, job)
        elif ours:
            state.todo.append(job)
        else:
            state.elsewhere.append(job)
