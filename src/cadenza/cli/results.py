"""Where results go: whether files can be written there, and what JSON has of them."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError


def check_name(path: Path, suffix: str, what: str) -> None:
    """Before anything is made for a file that has another format than its name says."""
    if path.suffix != suffix:
        raise CadenzaError(f"{path}: {what}; choose a name that ends so")


def check_writable(folder: Path) -> None:
    """Before anything is played for it."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise CadenzaError(
            f"{folder}: results cannot be written there ({error.strerror}); "
            "choose another folder with --output"
        ) from error


def write_json(path: Path, content: Any) -> None:
    """As a whole or not at all."""
    from cadenza.files import write_atomically

    with write_atomically(path) as file:
        file.write((json.dumps(plain(content), indent=2, allow_nan=False) + "\n").encode())


def plain(value: Any) -> Any:
    """The same as JSON has it: paths as text, null for what is not a number."""
    if isinstance(value, dict):
        return {name: plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float) and math.isnan(value):
        return None
    return str(value) if isinstance(value, Path) else value
