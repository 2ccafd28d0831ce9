"""Shows the progress of a command: a bar on a terminal, a line now and then anywhere else."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from tqdm import tqdm

    from cadenza.agents.agent import Progress

QUIET: ContextVar[bool] = ContextVar("QUIET", default=False)
"""Whether the command shows no progress."""

SECONDS_BETWEEN_LINES_OF_TRAINING = 30.0
"""Least time between lines of progress in a log of training, which takes minutes to hours [s]."""
_SECONDS_BETWEEN_LINES = 10.0  # of other work

_UNITS = {  # of stages that do not count steps
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
    """Show a stage of work on stderr, and yield what to call with units done and in all.

    A bar appears on a terminal after a second, and goes at the end. A file or a pipe gets a line
    at most every `seconds_between_lines`, none for shorter work, and no carriage returns.
    """
    if QUIET.get():
        yield _mute
    elif sys.stderr.isatty():
        bar = _Bar(doing, unit)
        try:
            yield bar
        finally:
            bar.close()
    else:
        yield _Lines(doing, unit, seconds_between_lines)


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
    """Show one stage of a performance after the other; `playing` is what that stage is called.

    What an agent does between its actions stands as a remark there.
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


class _Bar:
    def __init__(self, doing: str, unit: str) -> None:
        self._doing, self._unit = doing, unit
        self._bar: tqdm | None = None

    def __call__(self, done: int, total: int, remark: str = "") -> None:
        from tqdm import tqdm

        if self._bar is None:
            self._bar = tqdm(
                desc=self._doing,
                unit=f" {self._unit}",
                total=total,
                initial=done,
                delay=1.0,
                leave=False,
                smoothing=0,  # the mean rate since the first call
            )
        self._bar.total = total
        self._bar.set_postfix_str(remark, refresh=bool(remark) and done == self._bar.n)
        self._bar.update(done - self._bar.n)

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()


class _Lines:
    def __init__(self, doing: str, unit: str, seconds_between: float) -> None:
        self._doing, self._unit, self._between = doing, unit, seconds_between
        self._began: tuple[float, int] | None = None  # when, and what was done by then
        self._last = 0.0

    def __call__(self, done: int, total: int, remark: str = "") -> None:
        from tqdm import tqdm

        now = time.monotonic()
        if self._began is None:
            self._began, self._last = (now, done), now
        if now - self._last < self._between:
            return
        self._last = now
        started, already = self._began
        line = f"{self._doing}: {done} of {total} {self._unit}"
        if already < done < total:
            left = (total - done) * (now - started) / (done - already)
            line += f", {tqdm.format_interval(left)} left"
        print(line + (f", {remark}" if remark else ""), file=sys.stderr, flush=True)
