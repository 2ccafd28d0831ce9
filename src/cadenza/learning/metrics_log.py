"""RUN/metrics.jsonl, the metrics of a run, a row a line."""

import json
import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from cadenza.errors import CadenzaError
from cadenza.files import content_of, parsed_json

_MAX_BYTES = 2**28  # half a million rows

_Row = dict[str, Annotated[int, Meta(ge=-(2**53), le=2**53)] | float | None]


class MetricsLog:
    """The rows of a run, to which only the process that trains it appends."""

    def __init__(self, run: Path) -> None:
        self._path = run / "metrics.jsonl"

    def add(self, row: Mapping[str, float]) -> None:
        """Append a row; a number that is not finite becomes null."""
        plain = {name: finite(value) for name, value in row.items()}
        with open(self._path, "ab") as file:
            file.write((json.dumps(plain) + "\n").encode())
            file.flush()
            os.fsync(file.fileno())  # a checkpoint counts on all rows before it

    def rows(self) -> list[dict[str, Any]]:
        """The rows so far, each with `step` and `seconds`.

        Half a row at the end is left out. Lines that are no rows are, too, with a remark on
        standard error.
        """
        path, rows, skipped = self._path, [], 0
        if not path.exists():
            return []
        for line in content_of(path, _MAX_BYTES).split(b"\n")[:-1]:
            try:
                row = parsed_json(line.strip(b"\0"), _Row, path)
            except CadenzaError:
                row = {}
            if {"step", "seconds"} <= {name for name, value in row.items() if value is not None}:
                rows.append(row)
            else:
                skipped += 1
        if skipped:
            print(f"{path}: skipped lines that are not rows of metrics: {skipped}", file=sys.stderr)
        return rows

    @property
    def size(self) -> int:
        """The number of bytes, for `truncate`."""
        return self._path.stat().st_size if self._path.exists() else 0

    def truncate(self, size: int) -> None:
        """Drop what was written after a checkpoint: all but whole rows within `size` bytes."""
        if not self._path.exists():
            return
        with open(self._path, "r+b") as file:
            content = file.read(size)
            file.truncate(content.rfind(b"\n") + 1)
        if len(content) < size:
            print(f"{self._path}: rows of metrics are missing", file=sys.stderr)

    def delete(self) -> None:
        """Delete the file."""
        self._path.unlink(missing_ok=True)


def finite(value: float) -> float | None:
    """The number, or None in place of one that JSON does not have."""
    return value if math.isfinite(value) else None
