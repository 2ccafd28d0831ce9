"""The bytes and the text of a file that a user names, and titles that can be shown."""

import os
from difflib import get_close_matches
from pathlib import Path

from cadenza.errors import CadenzaError
from cadenza.files import opened

MAX_BYTES = 2 * 2**20  # an hour of dense piano music in MIDI needs about half of it


def read_bytes(path: Path, most: int = MAX_BYTES) -> bytes:
    """The bytes of a file.

    Raises CadenzaError if there is no such file, or it cannot be read, is empty or holds over
    `most` bytes.
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


def decoded(data: bytes, where: object) -> str:
    """The text in the bytes of a file.

    Raises CadenzaError if it is not in UTF-8; the message begins with `where`, and names the line.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise CadenzaError(f"{where}:{line}: not text in UTF-8; save it as that") from error


def _hint(path: Path) -> str:
    """Advice that names the files of the folder with a similar name."""
    try:
        names = os.listdir(path.parent)
    except (OSError, ValueError):
        return f"there is no folder {path.parent} either"
    close = [str(path.parent / name) for name in get_close_matches(path.name, names, cutoff=0.7)]
    return f"did you mean {' or '.join(close)}?" if close else "check its name"


_LONGEST = 500  # letters


def printable(text: str) -> str:
    """`text` on one line, without characters that cannot be printed, and shortened."""
    if not text.isprintable():
        text = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(text.split())[:_LONGEST].rstrip()


def title_of(path: Path) -> str:
    """The file's name without its suffix, with a mark for each byte that is not UTF-8."""
    return printable(os.fsencode(path.stem).decode("utf-8", "replace"))
