"""Output of commands: tables, warnings, and progress, as a bar on a terminal or as lines."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, Protocol

from cadenza.errors import CadenzaWarning, FileWarning, counted, on_one_line

if TYPE_CHECKING:
    from tqdm import tqdm

    from cadenza.agents.agent import Progress

QUIET: ContextVar[bool] = ContextVar("QUIET", default=False)
"""Whether the command shows no progress."""

SECONDS_BETWEEN_LINES_OF_TRAINING = 30.0
"""Minimum time between lines of progress in a log of training, which takes minutes to hours [s]."""
_SECONDS_BETWEEN_LINES = 10.0  # for other work

_UNITS = {  # units of stages that do not count steps
    "fingers": "notes",
    "motions": "motions",
    "postures": "iterations",
    "making the sound": "files",
    "drawing": "frames",
}


class Advance(Protocol):
    """The function that a stage of work calls to show its progress."""

    def __call__(self, done: int, total: int, remark: str = "") -> None:
        """Show how many of `total` units are done; time is counted from the first call."""


@contextmanager
def progress(
    doing: str, unit: str, seconds_between_lines: float = _SECONDS_BETWEEN_LINES
) -> Iterator[Advance]:
    """Show a stage of work on stderr; yields a function of units done and in all.

    A bar appears on a terminal after a second, and goes at the end. A file or a pipe gets a line
    at most every `seconds_between_lines`, none for shorter work, and no carriage returns.
    """
    if QUIET.get():
        yield _mute
    elif sys.stderr.isatty():
        with _bar(doing, unit) as bar:
            yield bar
    else:
        yield _lines(doing, unit, seconds_between_lines)


@contextmanager
def one_after_other() -> Iterator[Callable[..., None]]:
    """Yield a function that shows stages of work, which begin and end as their names change.

    It takes the name of the stage, its unit, units done, units in all, and perhaps a remark.
    """
    stage = ""
    advance: Advance = _mute
    with ExitStack() as shown:

        def show(now: str, unit: str, done: int, total: int, remark: str = "") -> None:
            nonlocal stage, advance
            if now != stage:
                shown.close()
                stage, advance = now, shown.enter_context(progress(now, unit))
            advance(done, total, remark)

        yield show


@contextmanager
def stages(playing: str) -> Iterator[Progress]:
    """Show one stage of a performance after the other; the stage "playing" is shown as `playing`.

    An agent's stages between its actions are remarks on that.
    """
    stage, last = "", (0, 0)
    with one_after_other() as show:

        def report(now: str, done: int, total: int) -> None:
            nonlocal stage, last
            if stage == "playing" != now:
                show(playing, "steps", *last, now)
                return
            stage, last = now, (done, total)
            show(playing if now == "playing" else now, _UNITS.get(now, "steps"), done, total)

        yield report


def _mute(done: int, total: int, remark: str = "") -> None:
    pass


@contextmanager
def _bar(doing: str, unit: str) -> Iterator[Advance]:
    from tqdm import tqdm

    bar: tqdm | None = None
    with ExitStack() as shown:

        def show(done: int, total: int, remark: str = "") -> None:
            nonlocal bar
            if bar is None:
                smoothing = 0  # the mean rate since the first call
                how: dict[str, Any] = {"delay": 1.0, "leave": False, "smoothing": smoothing}
                bar = tqdm(desc=doing, unit=f" {unit}", total=total, initial=done, **how)
                shown.callback(bar.close)
            bar.total = total
            bar.set_postfix_str(remark, refresh=bool(remark) and done == bar.n)
            bar.update(done - bar.n)

        yield show


def _lines(doing: str, unit: str, seconds_between: float) -> Advance:
    began: tuple[float, int] | None = None  # the time, and the units done by then
    last = 0.0

    def show(done: int, total: int, remark: str = "") -> None:
        from tqdm import tqdm

        nonlocal began, last
        now = time.monotonic()
        if began is None:
            began, last = (now, done), now
        if now - last < seconds_between:
            return
        last = now
        started, already = began
        line = f"{doing}: {done} of {total} {unit}"
        if already < done < total:
            left = (total - done) * (now - started) / (done - already)
            line += f", {tqdm.format_interval(left)} left"
        print(line + (f", {remark}" if remark else ""), file=sys.stderr, flush=True)

    return show


def in_columns(rows: Sequence[Sequence[str]], alignment: str = "<") -> str:
    """The cells of rows as a table, columns aligned by "<" or, beyond `alignment`, ">"."""
    ways = alignment.ljust(len(rows[0]), ">")
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    cells = [f"{way}{width}" for way, width in zip(ways, widths, strict=True)]
    lines = ("  ".join(map(format, row, cells)).rstrip() for row in rows)
    return "\n".join(lines)


@contextmanager
def stop_on_signal(last_work: str) -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed or SIGTERM has arrived.

    Until it is called for the first time, either ends the process at once. Afterwards the first of
    them only prints that the command stops after `last_work`, and the second ends the process.
    """
    signals, handlers = list[int](), dict[int, Any]()

    def restore() -> None:
        for number, handler in handlers.items():
            signal.signal(number, handler)

    def handle(number: int, _frame: Any) -> None:
        signals.append(number)
        restore()
        print(f"\nstopping after {last_work}; press Ctrl-C again to stop at once", file=sys.stderr)

    def stop() -> bool:
        if not handlers:
            handlers.update({n: signal.signal(n, handle) for n in (signal.SIGINT, signal.SIGTERM)})
        return bool(signals)

    try:
        yield stop
    finally:
        restore()


@contextmanager
def quietly(quiet: bool) -> Iterator[None]:
    """Show no progress and no results if `quiet`."""
    if not quiet:
        yield
        return
    token = QUIET.set(True)
    os.environ.setdefault("HF_HUB_DISABLE_PROGRESS_BARS", "1")
    try:
        with open(os.devnull, "w", errors="backslashreplace") as nowhere, redirect_stdout(nowhere):
            yield
    finally:
        QUIET.reset(token)


@contextmanager
def warnings_in_a_line(verbose: bool = True) -> Iterator[None]:
    """Print every CadenzaWarning once, as a line without the place in the code.

    At the end, several about the file are counted in one line, unless `verbose`.
    """
    show, printed, about_file = warnings.showwarning, set[str](), list[str]()

    def print_ours(
        message: Warning | str, category: type[Warning], *where: Any, **others: Any
    ) -> None:
        if issubclass(category, CadenzaWarning):
            text = on_one_line(str(message))
            if text in printed:
                return
            printed.add(text)
            if not verbose and issubclass(category, FileWarning):
                about_file.append(text)
            else:
                print(text, file=sys.stderr)
        else:
            show(message, category, *where, **others)

    with warnings.catch_warnings():
        # Python's own "once" forgets what it has shown whenever filters change.
        warnings.simplefilter("always", CadenzaWarning)
        warnings.showwarning = print_ours
        try:
            yield
        finally:
            if len(about_file) > 1:
                remarks = counted(len(about_file), "remark")
                about_file = [f"{remarks} on the file (--verbose shows them)"]
            for line in about_file:
                print(line, file=sys.stderr)


def open_closed_streams() -> None:
    """Open the null device in place of stdin, stdout or stderr where the caller has closed it.

    They are opened in this order, so that no file of ours is taken for one of them.
    """
    for name, mode in ("stdin", "r"), ("stdout", "w"), ("stderr", "w"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, errors="backslashreplace"))  # noqa: SIM115 - as long as we run
