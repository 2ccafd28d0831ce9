"""What commands print, and where results go: whether files can be written there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cadenza.errors import CadenzaError


def check_name(path: Path, suffix: str, what: str) -> None:
    """Before anything is made for a file that has another format than its name says."""
    if path.suffix != suffix:
        raise CadenzaError(f"{path}: {what}; choose a name with that ending")
    if path.is_dir():
        raise CadenzaError(f"{path}: is a folder; choose another name")


def check_writable(folder: Path, option: str = "--output", mode: int = 0o777) -> None:
    """Before anything is played for it; `option` chooses another, and a new one has this mode."""
    import tempfile

    try:
        folder.mkdir(mode, parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise CadenzaError(
            f"{folder}: results cannot be written there ({error.strerror}); "
            f"choose another folder with {option}"
        ) from error


def counted(number: int, noun: str) -> str:
    """Such as "1 step" or "2 steps"."""
    return f"{number} {noun}{'s'[: number != 1]}"


def in_columns(rows: Sequence[Sequence[str]]) -> str:
    """A table: names to the left, and figures, in all other columns, to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = (
        "  ".join([name.ljust(widths[0]), *map(str.rjust, figures, widths[1:])]).rstrip()
        for name, *figures in rows
    )
    return "\n".join(lines)
