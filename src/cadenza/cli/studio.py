"""`cadenza studio`: a page on which songs are dropped, and played while you watch."""

from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from cadenza.cli.saving import check_writable
from cadenza.configs import whole_number
from cadenza.errors import CadenzaError
from cadenza.installing import install_line

_MAX_PLAYERS = 4  # by default, as others may use the machine, too


@dataclass(frozen=True)
class StudioCommand:
    """Open a page on this machine: drop a song, and the hands play it while you watch.

    Ctrl-C ends it. Performances are kept for the next time.

    Example: cadenza studio
    """

    folder: Path = Path("played/studio")
    """Where songs and performances are kept."""
    port: int = 0
    """Port to listen on; the one of the last time, or any free one, by default."""
    host: str = "127.0.0.1"
    """Address to listen on. With any other than this machine's own, everybody who has the address
    of the page can use this machine to play."""
    jobs: int | None = None
    """Performances that are planned at the same time; by default one per core, up to four."""
    browser: bool = True
    """Open the page in a browser, where there is a screen."""


def run(command: StudioCommand) -> None:
    from cadenza.sim.threads import available_cores

    port = whole_number(command.port, "--port", 0, 65535)
    jobs = min(available_cores(), _MAX_PLAYERS) if command.jobs is None else command.jobs
    jobs = whole_number(jobs, "--jobs", 1, 64)
    check_writable(command.folder, "--folder", 0o700)  # it holds the address
    if any(find_spec(name) is None for name in ("starlette", "uvicorn", "websockets")):
        raise CadenzaError(f"pages need a web server: {install_line('studio')}")
    from cadenza.studio.page_server import announce, serve
    from cadenza.studio.server import Studio

    studio = Studio(command.folder, jobs)
    with suppress(KeyboardInterrupt):  # how it ends
        folder = studio.storage.folder
        ready = partial(announce, browser=command.browser, folder=folder)
        serve(studio.app, command.host, port, ready, folder / "address.json")
