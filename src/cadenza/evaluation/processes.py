"""Many runs, as many at once as fit, each in a process of its own.

The crash of one does not affect the others.
"""

import os
import signal
import sys
from collections.abc import Callable
from multiprocessing import connection, get_context, parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

from cadenza.evaluation.jobs import BenchJob
from cadenza.sim.threads import available_cores

CarryOut = Callable[[Any, Path, int, Callable[[], bool]], None]
"""Carries out a job, see `cadenza.evaluation.run.carry_out`."""
_SPAWN = get_context("spawn")  # MuJoCo and JAX do not survive a fork


class Ended(NamedTuple):
    """A run whose process has ended."""

    job: BenchJob
    crash: str = ""  # cause of death of the process, in a line; empty if it ended by itself


class ProcessExecutor:
    """An executor of `capacity` processes at once, each with `num_threads` planner threads."""

    def __init__(self, num_threads: int, num_jobs: int | None, carry_out: CarryOut) -> None:
        """Start `num_jobs` processes at once, or as many as cores allow."""
        # Read when numpy is first imported, which is before a process receives its job.
        os.environ.setdefault("OMP_NUM_THREADS", str(num_threads))
        self.capacity = num_jobs or max(available_cores() // num_threads, 1)
        self._num_threads, self._carry_out = num_threads, carry_out
        self._running: list[tuple[BenchJob, BaseProcess]] = []

    def start(self, job: BenchJob, folder: Path) -> None:
        """Begin to carry out a job in a process of its own."""
        process = _SPAWN.Process(
            target=_work, args=(self._carry_out, job, folder, self._num_threads)
        )
        # Ctrl-C of a terminal reaches all of its processes, and only this one is to act on it:
        # a child inherits the blocked signal. (The first start of a tracker would unblock it.)
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._running.append((job, process))

    def ended(self, seconds: float) -> list[Ended]:
        """Wait at most `seconds` for runs to end, and return the ended ones."""
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
        cause = "its process was killed (SIGKILL), as a system does when memory runs out"
        return Ended(job, cause)
    if status:
        cause = signal.Signals(-status).name if status < 0 else f"status {status}"
        return Ended(job, f"its process crashed ({cause}); see log.txt")
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
    """A function that tells whether SIGTERM has come; training then saves and ends."""
    signals = list[int]()
    signal.signal(signal.SIGTERM, lambda number, _: signals.append(number))
    return lambda: bool(signals)
