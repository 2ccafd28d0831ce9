"""Carries out many runs, and shows their progress in a table or line by line."""

from __future__ import annotations

import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import tyro

from cadenza.cli.console import stop_on_signal
from cadenza.cli.progress import QUIET
from cadenza.cli.saving import check_writable
from cadenza.configs import whole_number
from cadenza.errors import CadenzaError
from cadenza.sim.threads import MAX_THREADS

if TYPE_CHECKING:
    from cadenza.evaluation.bench import BenchState
    from cadenza.evaluation.jobs import BenchJob
    from cadenza.evaluation.processes import CarryOut


@dataclass(frozen=True)
class Execution:
    """Options of how runs are carried out."""

    retry: tyro.conf.FlagCreatePairsOff[bool] = False
    """Repeat the runs that failed before."""
    jobs: int | None = None
    """Number of runs at once. By default as many as the cores allow."""


class _Command(Protocol):
    """A command that carries out many runs."""

    @property
    def output(self) -> Path: ...
    @property
    def execution(self) -> Execution: ...
    @property
    def num_threads(self) -> int: ...


def check_execution(command: _Command) -> None:
    """Raise a CadenzaError if an option of how runs are carried out makes no sense."""
    for name, number in ("num_threads", command.num_threads), ("jobs", command.execution.jobs):
        if number is not None:
            whole_number(number, name, 1, MAX_THREADS)


@dataclass(frozen=True)
class Work:
    """The work that many runs share."""

    carry_out: CarryOut
    """Carries out one of them."""
    is_complete: Callable[[Any, Path], bool]
    """Returns whether nothing is left to do for a run in its folder."""
    outcome: Callable[[Path, BenchJob], str]
    """Returns a line on a run that has finished in its folder."""
    until: str
    """The last thing that happens after Ctrl-C, such as "a checkpoint"."""
    next_command: Sequence[str]
    """The command that sums the runs up."""


def run_all(command: _Command, jobs: Sequence[BenchJob], work: Work) -> None:
    """Carry out the jobs that are not complete yet, until Ctrl-C, and print what is left.

    Raises:
        KeyboardInterrupt: some runs are left.
        CadenzaError: some have failed.
    """
    from cadenza.evaluation.bench import bench
    from cadenza.evaluation.processes import ProcessExecutor
    from cadenza.evaluation.results import write_plan

    check_writable(command.output)
    write_plan(command.output, shlex.join(["cadenza", *sys.argv[1:]]), jobs)
    table, jobs_at_once = _Table(work), command.execution.jobs
    with (
        closing(ProcessExecutor(command.num_threads, jobs_at_once, work.carry_out)) as executor,
        closing(table),
        stop_on_signal(work.until) as stop,
    ):
        stop()  # from now on

        def should_continue(state: BenchState) -> bool:
            table.show(state)
            return not stop()

        retry = command.execution.retry
        state = bench(
            jobs, command.output, executor, table.ended, should_continue, retry, work.is_complete
        )
    _print_summary(state, command.output, work.next_command)


class _Table:
    """The runs under way, drawn anew in place; without a terminal, a line for each that ends."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._live = sys.stderr.isatty()
        self._lines = 0
        self._began: dict[str, float] = {}

    def show(self, state: BenchState) -> None:
        """Show how far the runs are now."""
        if not self._live or QUIET.get():
            return
        columns, rows = shutil.get_terminal_size()
        lines = [*self._rows(state, columns)][: rows - 2]
        total = _counts(
            state, under_way=len(state.running), under_way_elsewhere=len(state.elsewhere)
        )
        self.close()
        print(*(line[: columns - 1] for line in [*lines, total]), sep="\n", file=sys.stderr)
        self._lines = len(lines) + 1

    def ended(self, state: BenchState, job: BenchJob) -> None:
        """Print what became of a run that has finished or failed, or whose process has died."""
        if QUIET.get():
            return
        self.close()
        self._began.pop(job.spec.name, None)
        done = "" if self._live else f"{state.finished + len(state.failed)} of {state.total}: "
        print(f"{done}{_outcome_line(state, job, self._work)}", file=sys.stderr)

    def close(self) -> None:
        """Take away what `show` has drawn."""
        if self._lines:
            print(f"\x1b[{self._lines}F\x1b[J", end="", file=sys.stderr, flush=True)
        self._lines = 0

    def _rows(self, state: BenchState, columns: int) -> Iterator[str]:
        from cadenza.evaluation.run_status import read_progress

        now = time.monotonic()
        for name, job in state.running.items():
            seconds = now - self._began.setdefault(name, now)
            at = read_progress(state.folder / name)
            how_far = "beginning" if at is None else at.stage
            if at is not None and at.total:
                how_far += f" {100 * at.done // at.total} %"
            yield f"{_fitted_label(job, columns - 31)} {how_far:<20} {seconds:5.0f} s"


def _fitted_label(job: BenchJob, columns: int) -> str:
    """Return the name of a run; without enough room, its beginning is left out."""
    name = _label(job)
    return f"…{name[1 - columns :]}" if len(name) > columns else name.ljust(columns)


def _label(job: BenchJob) -> str:
    return f"{job.spec.song}  {job.spec.agent}  seed {job.spec.seed}"


def _outcome_line(state: BenchState, job: BenchJob, work: Work) -> str:
    if job.spec.name in state.failed:
        how = f"failed: {state.failed[job.spec.name]}"
    elif job in state.todo:
        how = f"{state.died[job.spec.name][-1]}; it will be taken up again"
    else:
        try:
            how = work.outcome(state.folder / job.spec.name, job)
        except (CadenzaError, OSError) as error:
            how = str(error)
    return f"{_label(job)}: {how}"


def _counts(state: BenchState, **others: int) -> str:
    """Return how many runs are finished, and how many failed and so on if there are any."""
    counts = {"failed": len(state.failed), **others}
    parts = [f"{state.finished} of {state.total} runs finished"]
    parts += [f"{count} {what.replace('_', ' ')}" for what, count in counts.items() if count]
    return ", ".join(parts)


def _print_summary(state: BenchState, folder: Path, next_command: Sequence[str]) -> None:
    """Print how many runs are finished, and which command sums them up.

    Raises:
        KeyboardInterrupt: some runs are left.
        CadenzaError: some have failed.
    """
    print(f"{_counts(state, left=state.left)}, in {folder}")
    for name, why in state.failed.items():
        print(f"{name}: {why}", file=sys.stderr)
    if state.left:
        print("run the same command again to go on", file=sys.stderr)
        raise KeyboardInterrupt
    print(f"To sum them up: {shlex.join(next_command)}")
    if state.failed:
        raise CadenzaError(
            f"{len(state.failed)} of {state.total} runs failed, as told above; once the causes are "
            "mended, add --retry to carry them out again"
        )
