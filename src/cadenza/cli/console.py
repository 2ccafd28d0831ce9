"""Tables, warnings, closed streams and Ctrl-C, as all commands handle them."""

import os
import signal
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from typing import Any, TextIO

from cadenza.cli.progress import QUIET
from cadenza.errors import CadenzaWarning, on_one_line


def in_columns(rows: Sequence[Sequence[str]], alignment: str = "<") -> str:
    """Return the cells of rows as a table, columns aligned by "<" or, beyond `alignment`, ">"."""
    ways = alignment.ljust(len(rows[0]), ">")
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    cells = [f"{way}{width}" for way, width in zip(ways, widths, strict=True)]
    lines = ("  ".join(map(format, row, cells)).rstrip() for row in rows)
    return "\n".join(lines)


@contextmanager
def stop_on_signal(what_comes: str) -> Iterator[Callable[[], bool]]:
    """Yield a function that says whether Ctrl-C was pressed or SIGTERM has arrived.

    Until it is called for the first time, either ends the process at once. Afterwards the first of
    them only prints that the command stops after `what_comes`, and the second ends the process.
    """
    asked, before = list[int](), dict[int, Any]()

    def as_before() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(number: int, _frame: Any) -> None:
        asked.append(number)
        as_before()
        print(f"\nstopping after {what_comes}; press Ctrl-C again to stop at once", file=sys.stderr)

    def stop() -> bool:
        if not before:
            before.update({n: signal.signal(n, ask) for n in (signal.SIGINT, signal.SIGTERM)})
        return bool(asked)

    try:
        yield stop
    finally:
        as_before()


@contextmanager
def quietly(quiet: bool) -> Iterator[None]:
    """Show no progress and no results if it is to be `quiet`."""
    if not quiet:
        yield
        return
    token = QUIET.set(True)
    os.environ.setdefault(
        "HF_HUB_DISABLE_PROGRESS_BARS", "1"
    )  # of the hub's library, if it is used
    try:
        with open(os.devnull, "w", errors="backslashreplace") as nowhere, redirect_stdout(nowhere):
            yield
    finally:
        QUIET.reset(token)


@contextmanager
def warnings_in_a_line() -> Iterator[None]:
    """Print every CadenzaWarning once, as a line without the place in the code."""
    show, printed = warnings.showwarning, set[str]()

    def print_ours(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, CadenzaWarning):
            text = on_one_line(str(message))
            if text not in printed:
                print(text, file=sys.stderr)
            printed.add(text)
        else:
            show(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        # Python's own "once" forgets what it has shown whenever filters change.
        warnings.simplefilter("always", CadenzaWarning)
        warnings.showwarning = print_ours
        yield


def open_closed_streams() -> None:
    """Open the null device in place of stdin, stdout or stderr where the caller has closed it.

    They are opened in this order, so that no file of ours is taken for one of them.
    """
    for name, mode in ("stdin", "r"), ("stdout", "w"), ("stderr", "w"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, errors="backslashreplace"))  # noqa: SIM115 - as long as we run
