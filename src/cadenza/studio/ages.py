"""When files were changed, in folders that others change while they are listed."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


def ages(paths: Iterable[Path]) -> dict[Path, float]:
    """When each was changed last [s since 1970], the newest first.

    What has gone meanwhile, or may not be looked at, is left out. A link is taken for itself.
    """
    found = {}
    for path in paths:
        with suppress(OSError):
            found[path] = path.lstat().st_mtime
    return dict(sorted(found.items(), key=lambda item: item[1], reverse=True))
