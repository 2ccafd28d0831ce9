"""Being asked to stop: once in good order, twice at once."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def asked_to_stop(what_comes: str) -> Iterator[Callable[[], bool]]:
    """Yields what says whether Ctrl-C was pressed or the process told to end.

    Until it is asked for the first time, either ends the process at once, and so does either
    afterwards: then nobody wants to wait for `what_comes`.
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
