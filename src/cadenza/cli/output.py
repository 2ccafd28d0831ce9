"""Where results go: whether files can be written there."""

from __future__ import annotations

from pathlib import Path

from cadenza.errors import CadenzaError


def check_name(path: Path, suffix: str, what: str) -> None:
    """Before anything is made for a file that has another format than its name says."""
    if path.suffix != suffix:
        raise CadenzaError(f"{path}: {what}; choose a name with that ending")


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
