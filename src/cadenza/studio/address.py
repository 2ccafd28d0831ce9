"""The address of the page, with a token that nobody else on this machine may read."""

import atexit
import os
import re
import stat
import tempfile
import webbrowser
from contextlib import suppress
from dataclasses import asdict, dataclass
from html import escape
from pathlib import Path

from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY, read_json, write_json

_TOKEN = re.compile(r"[\w-]{16,}")  # a shorter one could be guessed
_NUM_PORTS = 1 << 16
_PRIVATE = stat.S_IRUSR | stat.S_IWUSR
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
# A page that leads on to the address. A browser opens it by its path, which anybody may know.
_REDIRECT = """<!doctype html><meta charset="utf-8"><title>Cadenza</title>
<meta http-equiv="refresh" content="0; url={0}"><a href="{0}">Open the page</a>
"""


@dataclass(frozen=True)
class Address:
    """The token and port of a page, which stay from one time to the next."""

    token: str
    port: int

    def __post_init__(self) -> None:
        """Check port and token; raises ValueError if there is no such port, or token of ours."""
        if self.port not in range(_NUM_PORTS) or not _TOKEN.fullmatch(self.token):
            raise ValueError("no address of a page")


def read_address(path: Path) -> Address | None:
    """Return the last address, None without one; raises CadenzaError if others may know it."""
    if _is_open_to_others(path.parent, _OTHERS_WRITE):
        raise CadenzaError(
            f"{path.parent}: other users of this machine may change what is in it; choose another "
            f"folder with --folder, or take it for yourself: chmod 700 '{path.parent}'"
        )
    if not os.path.lexists(path):
        return None
    if _is_open_to_others(path, _OTHERS):
        raise CadenzaError(
            f"{path}: other users of this machine may know or have chosen the address of the page; "
            "delete this file, and a new one will be made"
        )
    with suppress(CadenzaError):
        return read_json(path, Address)
    return None


def _is_open_to_others(path: Path, permissions: int) -> bool:
    """Return whether others own a file or have one of these permissions (bits of a mode)."""
    about = path.lstat()
    if stat.S_ISLNK(about.st_mode):
        return True  # it may lead to a file of theirs
    return about.st_uid != os.getuid() or bool(about.st_mode & permissions)


def write_address(path: Path, address: Address) -> None:
    """Write a file that nobody else can read."""
    path.touch(_PRIVATE)
    path.chmod(_PRIVATE)  # which the file that takes its place keeps
    write_json(path, asdict(address))


def announce(address: str, browser: bool = True, folder: Path | None = None) -> None:
    """Print the address of the page, and open it where there is a screen and `browser` is true.

    Everybody on this machine can read the arguments of the browser, so that it is given a file of
    ours to open, in a folder of its own in `folder`, which leads on to the address. It is there
    until this process ends.
    """
    print(f"Open {address}", flush=True)
    if not browser or not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return
    private = tempfile.TemporaryDirectory(prefix=TEMPORARY, dir=folder)
    atexit.register(private.cleanup)
    page = Path(private.name) / "open.html"
    page.touch(_PRIVATE)
    page.write_text(_REDIRECT.format(escape(address)), "utf-8")
    webbrowser.open(page.absolute().as_uri())
