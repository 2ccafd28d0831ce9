"""Many runs: where they are carried out, and how far they are, in a table or line by line."""

from __future__ import annotations

import shlex
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol

from cadenza.cli.progress import QUIET
from cadenza.configs import whole_number
from cadenza.errors import CadenzaError
from cadenza.sim.threads import MOST_THREADS

if TYPE_CHECKING:
    from cadenza.evaluation.bench import BenchState, CarryOut, Executor
    from cadenza.evaluation.jobs import Job


class _Command(Protocol):
    """One that carries out many runs."""

    @property
    def num_threads(self) -> int: ...
    @property
    def jobs(self) -> int | None: ...
    @property
    def executor(self) -> Literal["local", "ray"]: ...
    @property
    def address(self) -> str | None: ...


def check_executor(command: _Command) -> None:
    """Raises: CadenzaError: an option of where runs are carried out makes no sense."""
    for name in "num_threads", "jobs":
        if (number := getattr(command, name)) is not None:
            whole_number(number, name, 1, MOST_THREADS)
    if command.executor == "local" and command.address is not None:
        raise CadenzaError("--address is that of a Ray cluster: add --executor ray")


def executor_of(command: _Command, carry_out: CarryOut) -> Executor:
    """Where the runs of a command are carried out."""
    if command.executor == "ray":
        from cadenza.evaluation.executors.ray import RayExecutor

        return RayExecutor(command.num_threads, command.jobs, command.address, carry_out)
    from cadenza.evaluation.executors.local import LocalExecutor

    return LocalExecutor(command.num_threads, command.jobs, carry_out)


HowItWent = Callable[[Path, "Job"], str]
"""Says in a line how a run in its folder went that has finished."""


class _Shown(Protocol):
    def show(self, state: BenchState) -> None:
        """How far it is now."""

    def ended(self, state: BenchState, job: Job) -> None:
        """A run has finished or failed, or its process has died."""


@contextmanager
def shown(how_it_went: HowItWent) -> Iterator[_Shown]:
    """A table of the runs under way on a terminal; a line for each that ends anywhere else."""
    if QUIET.get() or not sys.stderr.isatty():
        yield _Lines(how_it_went)
        return
    table = _Table(how_it_went)
    try:
        yield table
    finally:
        table.clear()


class _Lines:
    def __init__(self, how_it_went: HowItWent) -> None:
        self._how_it_went = how_it_went

    def show(self, state: BenchState) -> None:
        pass

    def ended(self, state: BenchState, job: Job) -> None:
        if not QUIET.get():
            done = state.finished + len(state.failed)
            print(
                f"{done} of {state.total}: {_what_became_of(state, job, self._how_it_went)}",
                file=sys.stderr,
            )


class _Table:
    """Drawn anew in its place twice a second; what has ended scrolls by above it."""

    def __init__(self, how_it_went: HowItWent) -> None:
        self._how_it_went = how_it_went
        self._lines = 0
        self._began: dict[str, float] = {}

    def show(self, state: BenchState) -> None:
        columns, rows = shutil.get_terminal_size()
        lines = [*self._rows(state, columns)][: rows - 2]
        self.clear()
        print(
            *(line[: columns - 1] for line in [*lines, _in_all(state)]), sep="\n", file=sys.stderr
        )
        self._lines = len(lines) + 1

    def ended(self, state: BenchState, job: Job) -> None:
        self.clear()
        self._began.pop(job.spec.name, None)
        print(_what_became_of(state, job, self._how_it_went), file=sys.stderr)

    def clear(self) -> None:
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
            yield f"{_named_in(job, columns - 31)} {how_far:<20} {seconds:5.0f} s"


def _named_in(job: Job, columns: int) -> str:
    """Where there is not enough room, the beginning of the song's name is left out."""
    name = _named(job)
    return f"…{name[1 - columns :]}" if len(name) > columns else name.ljust(columns)


def _named(job: Job) -> str:
    return f"{job.spec.song}  {job.spec.agent}  seed {job.spec.seed}"


def _what_became_of(state: BenchState, job: Job, how_it_went: HowItWent) -> str:
    if job.spec.name in state.failed:
        how = f"failed: {state.failed[job.spec.name]}"
    elif job in state.todo:
        how = f"{state.died[job.spec.name][-1]}; it will be taken up again"
    else:
        try:
            how = how_it_went(state.folder / job.spec.name, job)
        except (CadenzaError, OSError) as error:
            how = str(error)
    return f"{_named(job)}: {how}"


def _in_all(state: BenchState) -> str:
    parts = [f"{state.finished} of {state.total} runs finished"]
    parts += [f"{len(state.failed)} failed"] * bool(state.failed)
    parts += [f"{len(state.running)} under way"] * bool(state.running)
    parts += [f"{len(state.elsewhere)} under way elsewhere"] * bool(state.elsewhere)
    return ", ".join(parts)


def tell_what_is_left(state: BenchState, folder: Path, to_sum_up: Sequence[str]) -> None:
    """And the command that sums them up.

    Raises: KeyboardInterrupt or CadenzaError: not all runs are finished.
    """
    parts = [f"{state.finished} of {state.total} runs finished"]
    parts += [f"{len(state.failed)} failed"] * bool(state.failed)
    parts += [f"{state.left} left"] * bool(state.left)
    print(f"{', '.join(parts)}, in {folder}")
    for name, why in state.failed.items():
        print(f"{name}: {why}", file=sys.stderr)
    if state.left:
        print("run the same command again to go on", file=sys.stderr)
        raise KeyboardInterrupt
    print(f"To sum them up: {shlex.join(to_sum_up)}")
    if state.failed:
        raise CadenzaError(
            f"{len(state.failed)} of {state.total} runs failed, as told above; once the causes are "
            "mended, add --retry to carry them out again"
        )
