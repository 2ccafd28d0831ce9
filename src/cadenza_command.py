"""The command `cadenza`: it begins before anything of the package is imported.

The imports take a second. Ctrl-C meanwhile would print where they are, or what a library makes of
it.
"""

import os
import signal
import sys
from typing import Any

_INTERRUPTED = 130


def main() -> None:
    """Run the command line, see `cadenza.cli.main`."""
    heeded = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    try:
        if heeded:
            signal.signal(signal.SIGINT, _end)
        from cadenza.cli import main

        if heeded:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        main()
    except KeyboardInterrupt:  # once more, while the command was ending
        sys.exit(_INTERRUPTED)


def _end(_number: int, _frame: Any) -> None:
    os._exit(_INTERRUPTED)
