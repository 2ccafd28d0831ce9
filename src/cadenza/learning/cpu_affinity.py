"""Training runs on CPU cores of their own, so that several run side by side."""

import errno
import os
import stat
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import count, islice
from pathlib import Path

from cadenza.files import locked_file


@contextmanager
def claimed_cores(number: int) -> Iterator[set[int]]:
    """Keep this process and the threads that it starts to cores that no other run has claimed.

    Yields fewer than `number` cores where fewer are left. Where none is left, it yields none,
    shares the core with the fewest runs, and says so on standard error. A claim ends with the
    process, however it ends. Nothing happens where a system cannot keep processes to cores, or has
    no folder for claims that only this user can write to.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield set()
        return
    all_cores = os.sched_getaffinity(0)
    with ExitStack() as stack:
        try:
            folder = _claims_folder()
            own = set(islice(_claims(folder, stack, all_cores, share=0), number))
            shared = (core for n in count(1) for core in _claims(folder, stack, all_cores, n))
            affinity = own or {next(shared)}
        except OSError as error:
            why = f"{error.strerror}: {error.filename}"
            print(f"parallel runs may share cores ({why})", file=sys.stderr)
            own, affinity = set(), all_cores
        else:
            if not own:
                print("all cores are in use by other runs: sharing one", file=sys.stderr)
        os.sched_setaffinity(0, affinity)
        try:
            yield own
        finally:
            os.sched_setaffinity(0, all_cores)


def _claims_folder() -> Path:
    """The folder of this user's lock files, `CORE.SHARE`; raises OSError if others could write."""
    folder = Path(tempfile.gettempdir()) / f"cadenza-cores-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    status = folder.lstat()
    others = stat.S_IWGRP | stat.S_IWOTH
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.getuid() or status.st_mode & others:
        raise OSError(errno.EPERM, "not a folder that only you can write to", str(folder))
    return folder


def _claims(folder: Path, stack: ExitStack, cores: set[int], share: int) -> Iterator[int]:
    """Claim cores one by one whose `share` is free, until `stack` ends; raises OSError."""
    for core in sorted(cores):
        if stack.enter_context(locked_file(folder / f"{core}.{share}")):
            yield core
