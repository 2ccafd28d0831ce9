"""The bytes of a file of music, as a person names it."""

from __future__ import annotations

import os
from difflib import get_close_matches
from pathlib import Path

from cadenza.errors import CadenzaError
from cadenza.files import opened

MAX_BYTES = 2 * 2**20  # an hour of dense piano music in MIDI needs about half of it


def read_bytes(path: Path, most: int = MAX_BYTES) -> bytes:
    """What the file holds, which is something and at most `most` bytes.

    Raises:
        CadenzaError: it is not there, cannot be read, is empty or larger.
    """
    if os.path.isdir(path):
        raise CadenzaError(f"{path}: is a folder; give a file")
    try:
        with opened(path) as file:
            data = file.read(most + 1)
    except FileNotFoundError:
        if path.is_symlink():
            what = f"leads to {os.readlink(path)}, where there is no file"
        else:
            what = f"there is no such file; {_hint(path)}"
        raise CadenzaError(f"{path}: {what}") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise CadenzaError(f"{path}: cannot be read ({reason})") from error
    if not data:
        raise CadenzaError(f"{path}: the file is empty; give another")
    if len(data) > most:
        raise CadenzaError(f"{path}: over {most >> 20} MiB, too large for a song")
    return data


def _hint(path: Path) -> str:
    """Which files of that folder have a name like it."""
    try:
        names = os.listdir(path.parent)
    except (OSError, ValueError):
        return f"there is no folder {path.parent} either"
    close = [str(path.parent / name) for name in get_close_matches(path.name, names, cutoff=0.7)]
    return f"did you mean {' or '.join(close)}?" if close else "check its name"
