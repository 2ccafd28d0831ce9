"""Limits on uploads, and limits that a process sets for itself before it reads foreign files.

`python -m cadenza.studio.limits MODULE ARGUMENT...` runs a module as a process that ends with the
server, even where that is killed. It writes a byte to stdout before the module runs. Only then may
the server suspend it: suspended before, it would outlive the server, with its memory and locks.
"""

import ctypes
import os
import runpy
import signal
import sys
from typing import NamedTuple

MAX_BYTES = 4 << 20  # bytes of an upload
MAX_SECONDS = 31 * 60.0  # seconds of music: half an hour, and a little for the last note
MAX_NOTES = 40_000
READING_SECONDS = 120.0  # time to read a file, on a busy machine

_GIB = 1 << 30
_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG


class Limits(NamedTuple):
    """Memory for data [bytes], CPU time [s], and the size that a file may grow to [bytes]."""

    memory: int
    cpu: int
    file: int


READING = Limits(1 * _GIB, 20, 1 << 26)
PLAYING = Limits(6 * _GIB, 24 * 3600, 4 * _GIB)


def limit(limits: Limits) -> None:
    """Set limits for this process, which leaves no core dump either."""
    import resource  # which only Unix has

    kinds = resource.RLIMIT_DATA, resource.RLIMIT_CPU, resource.RLIMIT_FSIZE, resource.RLIMIT_CORE
    for kind, maximum in zip(kinds, (*limits, 0), strict=True):
        _, hard = resource.getrlimit(kind)
        maximum = maximum if hard == resource.RLIM_INFINITY else min(maximum, hard)
        resource.setrlimit(kind, (maximum, maximum))


def main() -> None:
    """Run a module that ends with its parent; only Linux can, elsewhere the module just runs."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, ctypes.c_ulong(signal.SIGKILL))
    os.write(1, b"\n")
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
