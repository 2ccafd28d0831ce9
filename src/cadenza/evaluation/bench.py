"""Carries out many runs, as many at once as there is room for, each in a process of its own.

One that crashes takes no other with it.
"""

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing import connection, get_context, parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

from cadenza.errors import CadenzaError
from cadenza.evaluation.jobs import BenchJob
from cadenza.evaluation.results import FAILED, RUNS, failure, is_finished
from cadenza.evaluation.run import folder_of, write_failure
from cadenza.sim.threads import available_cores

CarryOut = Callable[[Any, Path, int, Callable[[], bool]], None]
"""Carries out a job, see `cadenza.evaluation.run.carry_out`."""
_SPAWN = get_context("spawn")  # MuJoCo and JAX do not survive a fork


class Ended(NamedTuple):
    """A run whose process has ended."""

    job: BenchJob
    crash: str = ""  # cause of death of the process, in a line; empty if it ended by itself


class ProcessExecutor:
    """Runs `capacity` processes at once, each with `num_threads` threads for its planner."""

    def __init__(self, num_threads: int, num_jobs: int | None, carry_out: CarryOut) -> None:
        """Start as many processes as cores allow, unless a number is given."""
        # Read when numpy is first imported, which is before a process knows what it is to do.
        os.environ.setdefault("OMP_NUM_THREADS", str(num_threads))
        self.capacity = num_jobs or max(available_cores() // num_threads, 1)
        self._num_threads, self._carry_out = num_threads, carry_out
        self._running: list[tuple[BenchJob, BaseProcess]] = []

    def start(self, job: BenchJob, folder: Path) -> None:
        """Begin to carry out a job in a process of its own."""
        process = _SPAWN.Process(
            target=_work, args=(self._carry_out, job, folder, self._num_threads)
        )
        # Ctrl-C of a terminal goes to all of its processes, and only we are to act on it: what is
        # blocked here is blocked there. (The first start of a tracker would unblock it.)
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._running.append((job, process))

    def ended(self, seconds: float) -> list[Ended]:
        """Wait for runs to end, at most for `seconds`, and return those."""
        connection.wait([process.sentinel for _, process in self._running], seconds)
        before, self._running, ended = self._running, [], []
        for job, process in before:
            if process.is_alive():
                self._running.append((job, process))
            else:
                ended.append(_ended(job, process))
        return ended

    def stop(self) -> None:
        """End all runs under way so that they can be resumed."""
        for _, process in self._running:
            process.terminate()
        for _, process in self._running:
            process.join()
        self._running.clear()

    def close(self) -> None:
        """Kill the runs that are still under way."""
        for _, process in self._running:
            process.kill()


def _ended(job: BenchJob, process: BaseProcess) -> Ended:
    process.join()
    status = process.exitcode or 0
    process.close()
    if status == -signal.SIGKILL:
        why = "its process was killed (SIGKILL), as a system does when memory runs out"
        return Ended(job, why)
    if status:
        how = signal.Signals(-status).name if status < 0 else f"status {status}"
        return Ended(job, f"its process crashed ({how}); see log.txt")
    return Ended(job)


def _work(carry_out: CarryOut, job: BenchJob, folder: Path, num_threads: int) -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    stop = _stop_requested() if job.spec.training is not None else lambda: False
    carry_out(job, folder, num_threads, stop)
    sys.stdout.flush()


def _end_with_parent() -> None:
    """End this process when its bench is killed."""
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _stop_requested() -> Callable[[], bool]:
    """Return what says whether the process has been told to end; training then saves first."""
    asked = list[int]()
    signal.signal(signal.SIGTERM, lambda number, _: asked.append(number))
    return lambda: bool(asked)


_POLL_INTERVAL = 0.5  # [s]
_MAX_ATTEMPTS = 3  # at a run whose process dies


@dataclass
class BenchState:
    """State of a bench; runs have the names of their folders."""

    folder: Path  # the folder of all runs
    total: int
    # Whether nothing is left to do for a run in its folder
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
        """The number of the others."""
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
    """Carry out what is not complete yet, also runs that have failed before if `retry`.

    `ended` is called with each run that has finished or failed, or is tried again since its process
    has died. `should_continue` is often asked; once it says False, all runs are ended.
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
                _is_finished(state, job)  # counts what had ended before it could be stopped
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
    """Return whether a run has ended well, and count it if it has."""
    folder = state.folder / job.spec.name
    finished = state.is_complete(job, folder) and not (folder / FAILED).exists()
    state.finished += finished
    return finished


def _has_failed(state: BenchState, job: BenchJob) -> bool:
    try:
        why = failure(state.folder / job.spec.name)
    except CadenzaError as error:  # what it says is corrupt
        why = str(error)
    if why is not None:
        state.failed[job.spec.name] = why
    return why is not None


def _process_ended(state: BenchState, job: BenchJob, crash: str) -> bool:
    """Record how a run ended; return False where another process works on it."""
    name, folder = job.spec.name, state.folder / job.spec.name
    if _is_finished(state, job):
        return True
    with folder_of(job, folder).claimed() as ours:
        if not ours:
            return False
        if crash or not (folder / FAILED).exists():
            why = crash or "its process ended without a result; see log.txt"
            died = state.died.setdefault(name, [])
            died.append(why)
            if len(died) < _MAX_ATTEMPTS:
                state.todo.append(job)  # after all others: there may be more memory then
                return True
            write_failure(folder, f"{why}; so it went {_MAX_ATTEMPTS} times")
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
