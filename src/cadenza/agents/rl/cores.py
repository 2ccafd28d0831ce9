"""Which cores a run of training works on, so that several run side by side."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count, islice
from pathlib import Path
from typing import IO


@contextmanager
def claimed_cores(number: int) -> Iterator[set[int]]:
    """Keeps this process and the threads that it starts to cores that no other run has claimed.

    Fewer than `number` where fewer are left; where none is, nothing is yielded and one core shared,
    as evenly as there are such runs. A claim ends with the process, however it ends. Where a system
    cannot keep processes to cores, nothing happens.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield set()
        return
    all_cores = os.sched_getaffinity(0)
    with ExitStack() as stack:
        own = list(islice(_claims(stack, all_cores, share=0), number))
        # Where none is free, one that the fewest share.
        shared = (core for share in count(1) for core in _claims(stack, all_cores, share))
        os.sched_setaffinity(0, own or {next(shared)})
        try:
            yield set(own)
        finally:
            os.sched_setaffinity(0, all_cores)


def _claims(stack: ExitStack, cores: set[int], share: int) -> Iterator[int]:
    """Those cores of which nobody has this share, claimed as they are asked for."""
    for core in sorted(cores):
        if file := _claim(f"{core}.{share}"):
            stack.enter_context(file)
            yield core


def _claim(name: str) -> IO[bytes] | None:
    """A locked file that stands for a share of a core, None if another process holds it."""
    folder = Path(tempfile.gettempdir()) / f"cadenza-cores-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    file = open(folder / name, "wb")  # noqa: SIM115 - open as long as the claim
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        file.close()
        return None
    return file
