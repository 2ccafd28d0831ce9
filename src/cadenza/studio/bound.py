"""Runs a module as a process that ends with the server, even where that is killed.

`python -m cadenza.studio.bound MODULE ARGUMENT...` says so by a byte on stdout before the module
runs. Only from then on may the server hold it: what stands still could not see to its end, and
would be left behind with its memory and its locks.
"""

from __future__ import annotations

import ctypes
import os
import runpy
import signal
import sys

_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG


def main() -> None:
    """See above. Only Linux knows of such an end; elsewhere the module just runs."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, ctypes.c_ulong(signal.SIGKILL))
    os.write(1, b"\n")
    del sys.argv[0]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
