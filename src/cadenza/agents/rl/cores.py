"""Which cores a run of training works on, so that several run side by side."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO


@contextmanager
def claimed_cores(number: int) -> Iterator[set[int]]:
    """Keeps this process and the threads that it starts to cores that no other run has claimed.

    Fewer than `number` where fewer are left; where none is, one core, shared. A claim ends with
    the process, however it ends. Where a system cannot keep processes to cores, nothing happens.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield set()
        return
    all_cores = os.sched_getaffinity(0)
    with ExitStack() as stack:
        mine: set[int] = set()
        for core in sorted(all_cores):
            if len(mine) < number and (file := _claim(core)):
                stack.enter_context(file)
                mine.add(core)
        os.sched_setaffinity(0, mine or {sorted(all_cores)[os.getpid() % len(all_cores)]})
        try:
            yield mine
        finally:
            os.sched_setaffinity(0, all_cores)


def _claim(core: int) -> IO[bytes] | None:
    """A locked file that stands for the core, None if another process holds it."""
    folder = Path(tempfile.gettempdir()) / f"cadenza-cores-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    file = open(folder / str(core), "wb")  # noqa: SIM115 - open as long as the claim
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    return file
