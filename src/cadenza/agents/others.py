"""Agents that somebody else has written, and what goes wrong in them."""

from __future__ import annotations

import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager

from cadenza.errors import CadenzaError


@contextmanager
def by_others(what: str) -> Iterator[None]:
    """Raises as a CadenzaError of a line whatever goes wrong in the block; it begins with `what`.

    The error itself is its cause. Files that cannot be read or written stay what they are.
    """
    try:
        yield
    except (CadenzaError, OSError):
        raise
    except (Exception, SystemExit) as error:  # a module may end the process
        frame = traceback.extract_tb(error.__traceback__)[-1]
        said = " ".join(f"{type(error).__name__}: {error}".split())
        where = f" ({frame.filename}, line {frame.lineno})"
        # Python's own machinery of imports has no file.
        raise CadenzaError(f"{what}: {said}{where * os.path.isfile(frame.filename)}") from error
