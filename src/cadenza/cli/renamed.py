"""Options as they were called before, which work for one version more."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from cadenza.learning.old_formats import RENAMED

OPTIONS = {
    **{f"--{old}".replace("_", "-"): f"--{new}".replace("_", "-") for old, new in RENAMED.items()},
    "--keep-zero-inputs": "--no-prune-inputs",
    "--no-keep-zero-inputs": "--prune-inputs",
    "--threads": "--num-threads",
}
"""Old name -> new name."""


def with_new_names(arguments: Sequence[str]) -> list[str]:
    """The same arguments; says on standard error which names are old."""
    renewed = []
    for argument in arguments:
        option, equals, value = argument.partition("=")
        if (new := OPTIONS.get(option.replace("_", "-"))) is not None:
            print(f"{option} is now {new}; the next version takes only that", file=sys.stderr)
            argument = new + equals + value
        renewed.append(argument)
    return renewed
