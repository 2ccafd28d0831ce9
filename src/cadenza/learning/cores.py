"""Which cores a run of training works on, so that several run side by side."""

from __future__ import annotations

import errno
import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count, islice
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def claimed_cores(number: int) -> Iterator[set[int]]:
    """Keeps this process and the threads that it starts to cores that no other run has claimed.

    Fewer than `number` where fewer are left; where none is, nothing is yielded and one core shared,
    as evenly as there are such runs, which is said on standard error. A claim ends with the
    process, however it ends. Where a system cannot keep processes to cores, or there is no folder
    for claims that nobody else can write to, nothing happens.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield set()
        return
    all_cores = os.sched_getaffinity(0)
    with ExitStack() as stack:
        try:
            folder = _folder()
            own = set(islice(_claims(folder, stack, all_cores, share=0), number))
            # Where none is free, one that the fewest share.
            shared = (core for n in count(1) for core in _claims(folder, stack, all_cores, n))
            kept = own or {next(shared)}
        except OSError as error:
            why = f"{error.strerror}: {error.filename}"
            print(f"parallel runs may share cores ({why})", file=sys.stderr)
            own, kept = set(), all_cores
        else:
            if not own:
                print("all cores are in use by other runs: sharing one", file=sys.stderr)
        os.sched_setaffinity(0, kept)
        try:
            yield own
        finally:
            os.sched_setaffinity(0, all_cores)


def _folder() -> Path:
    """Where claims are.

    Raises:
        OSError: somebody else could write there.
    """
    folder = Path(tempfile.gettempdir()) / f"cadenza-cores-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    there = folder.lstat()
    for_others = stat.S_IWGRP | stat.S_IWOTH
    if not stat.S_ISDIR(there.st_mode) or there.st_uid != os.getuid() or there.st_mode & for_others:
        raise OSError(errno.EPERM, "not a folder that only you can write to", str(folder))
    return folder


def _claims(folder: Path, stack: ExitStack, cores: set[int], share: int) -> Iterator[int]:
    """Those cores of which nobody has this share, claimed as they are asked for.

    Raises:
        OSError: they cannot be claimed.
    """
    for core in sorted(cores):
        lock = FileLock(folder / f"{core}.{share}")
        try:
            lock.acquire(blocking=False)
        except Timeout:
            continue
        stack.callback(lock.release)
        yield core
