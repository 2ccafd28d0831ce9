"""The page of the studio: its parts, and the server that listens for those who open it."""

import os
import secrets
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple
from functools import cache
from importlib import resources
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from cadenza.errors import CadenzaError
from cadenza.report.html_pages import PLAYING, asset, rendered
from cadenza.studio.address import Address, announce, read_address, write_address

_OWN = (
    *("requests.js", "instrument.js", "keyboard.js", "stream.js", "library.js", "player.js"),
    *("performances.js", "background.js", "studio.js"),
)
_KEEP_ALIVE = 5  # [s] that a connection without requests stays open
_SHUTDOWN_TIME = 2  # [s] that requests have to end when the server does
_MAX_RECEIVED = 1 << 12  # bytes of a message of the page, which has nothing to send
_KILLED = 128  # what shells add to the number of a signal that ends a process


def _own(name: str) -> str:
    """Return a file of the studio's own page."""
    return resources.files("cadenza.studio").joinpath("page", name).read_text("utf-8")


@cache
def page() -> str:
    """Return the page itself."""
    return rendered(_own("studio.html"))


@cache
def _scripts() -> str:
    parts = [*map(asset, PLAYING), *map(_own, _OWN)]
    return '"use strict";(async () => {\n' + "\n".join(parts) + "\n})();\n"


@cache
def _styles() -> str:
    # A sum would escape the quotes of our own.
    return "".join((asset("page.css"), asset("score.css"), _own("studio.css")))


PARTS: dict[str, tuple[str, Callable[[], str]]] = {
    "studio.css": ("text/css", _styles),
    "studio.js": ("text/javascript", _scripts),
    "three.js": ("text/javascript", lambda: asset("three.min.js")),
}
"""The type and the content of each style sheet and script, by name."""


def _bound_socket(host: str, ports: Sequence[int]) -> socket.socket:
    """Listen at the first free port; raises CadenzaError if none is, or no such address."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    for port in ports:
        try:
            return socket.create_server((host, port), family=family)
        except OSError as error:
            if port == ports[-1]:
                raise CadenzaError(
                    f"cannot listen on {host}, port {port}: {error.strerror}"
                ) from error
    raise AssertionError


class _SendOnlyWebSocket(WebSocketsSansIOProtocol):
    """A protocol that drops what the page sends; Uvicorn prints a traceback for invalid text."""

    def send_receive_event_to_app(self) -> None:
        self.frames = []


def serve(
    app: Callable[[str, str], ASGIApp],
    host: str = "127.0.0.1",
    port: int = 0,
    ready: Callable[[str], None] = announce,
    address_file: Path | None = None,
) -> None:
    """Serve until the process is told to end.

    Raises CadenzaError if somebody else listens there, there is no such address, or others may have
    written the file.

    Args:
        app: makes what is served of its token and host.
        host, port: where to listen; port 0 is the one of the last time, or any.
        ready: is called with the address to open, which holds a random token.
        address_file: keeps token and port for the next time, so that links stay valid.
    """
    os.environ["PYTHONSAFEPATH"] = "1"  # no process of ours imports from the working folder
    known = None if address_file is None else read_address(address_file)
    token, last_port = astuple(known or Address(secrets.token_urlsafe(16), 0))
    with _bound_socket(host, [port] if port else [last_port, 0]) as listening:
        port = listening.getsockname()[1]
        if address_file is not None and known is None:
            write_address(address_file, Address(token, port))
        shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        shown = f"[{shown}]" if ":" in shown else shown
        ready(f"http://{shown}:{port}/{token}/")
        config = uvicorn.Config(
            app(token, host),
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            date_header=False,
            http="h11",
            ws=_SendOnlyWebSocket,
            timeout_keep_alive=_KEEP_ALIVE,
            timeout_graceful_shutdown=_SHUTDOWN_TIME,
            ws_max_size=_MAX_RECEIVED,
            ws_per_message_deflate=False,  # it goes no further than this machine, mostly
        )
        server = uvicorn.Server(config)
        with _clean_exit(server):
            server.run(sockets=[listening])


@contextmanager
def _clean_exit(server: uvicorn.Server) -> Iterator[None]:
    """End the server in order by any signal, also when its terminal closes.

    Else its processes would be left behind, and a file with its address.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    closed = signal.signal(signal.SIGHUP, lambda *_: server.handle_exit(signal.SIGTERM, None))
    ended = signal.signal(signal.SIGTERM, _exit)  # to which Uvicorn comes back
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, closed)
        signal.signal(signal.SIGTERM, ended)


def _exit(number: int, _: object) -> None:
    sys.exit(_KILLED + number)
