"""Many runs, carried out with progress."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from cadenza.cli.printing import QUIET, SECONDS_BETWEEN_LINES_OF_TRAINING, progress, stop_on_signal
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


def check_execution(num_threads: int, execution: Execution) -> None:
    """Raise a CadenzaError if an option of how runs are carried out makes no sense."""
    for name, number in ("num_threads", num_threads), ("jobs", execution.jobs):
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


def run_all(
    folder: Path, num_threads: int, execution: Execution, jobs: Sequence[BenchJob], work: Work
) -> None:
    """Carry out incomplete jobs in a folder until Ctrl-C, and print how many are left.

    Raises KeyboardInterrupt if some runs are left, or CadenzaError if some have failed.
    """
    from tqdm import tqdm

    from cadenza.evaluation.bench import bench
    from cadenza.evaluation.processes import ProcessExecutor
    from cadenza.evaluation.results import write_plan

    check_writable(folder)
    write_plan(folder, shlex.join(["cadenza", *sys.argv[1:]]), jobs)
    with (
        closing(ProcessExecutor(num_threads, execution.jobs, work.carry_out)) as executor,
        progress("running", "runs", SECONDS_BETWEEN_LINES_OF_TRAINING) as advance,
        stop_on_signal(work.until) as stop,
    ):
        stop()  # signals are caught from its first call on

        def should_continue(state: BenchState) -> bool:
            advance(state.done, state.total, ", ".join(_under_way(state)))
            return not stop()

        def ended(state: BenchState, job: BenchJob) -> None:
            if not QUIET.get():
                line = f"{state.done} of {state.total}: {_outcome_line(state, job, work)}"
                tqdm.write(line, file=sys.stderr)

        retry = execution.retry
        state = bench(jobs, folder, executor, ended, should_continue, retry, work.is_complete)
    _print_summary(state, folder, work.next_command)


def _under_way(state: BenchState) -> Iterator[str]:
    """Yield the progress of each run under way here, and the number of runs elsewhere."""
    from cadenza.evaluation.run_status import read_progress

    for name, job in state.running.items():
        at = read_progress(state.folder / name)
        percent = f" {100 * at.done // at.total} %" if at is not None and at.total else ""
        yield f"{_label(job)} {'beginning' if at is None else at.stage}{percent}"
    if state.elsewhere:
        yield f"{len(state.elsewhere)} elsewhere"


def _label(job: BenchJob) -> str:
    return f"{job.spec.song}  {job.spec.agent}  seed {job.spec.seed}"


def _outcome_line(state: BenchState, job: BenchJob, work: Work) -> str:
    if job.spec.name in state.failed:
        outcome = f"failed: {state.failed[job.spec.name]}"
    elif job in state.todo:
        outcome = f"{state.died[job.spec.name][-1]}; it will be taken up again"
    else:
        try:
            outcome = work.outcome(state.folder / job.spec.name, job)
        except (CadenzaError, OSError) as error:
            outcome = str(error)
    return f"{_label(job)}: {outcome}"


def _print_summary(state: BenchState, folder: Path, next_command: Sequence[str]) -> None:
    """Print how many runs are finished, and which command sums them up; raises as `run_all`."""
    counts = {"failed": len(state.failed), "left": state.left}
    rest = "".join(f", {count} {status}" for status, count in counts.items() if count)
    print(f"{state.finished} of {state.total} runs finished{rest}, in {folder}")
    for name, reason in state.failed.items():
        print(f"{name}: {reason}", file=sys.stderr)
    if state.left:
        print("run the same command again to go on", file=sys.stderr)
        raise KeyboardInterrupt
    print(f"To sum them up: {shlex.join(next_command)}")
    if state.failed:
        raise CadenzaError(
            f"{len(state.failed)} of {state.total} runs failed, as told above; once the causes are "
            "mended, add --retry to carry them out again"
        )
