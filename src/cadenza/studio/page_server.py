"""The page of the studio: its parts, its server, and its address.

The address has a token that other users of this machine cannot read: only a page of the studio
itself, opened with it, reaches the server.
"""

import atexit
import ipaddress
import os
import re
import secrets
import signal
import socket
import stat
import sys
import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, astuple, dataclass
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from urllib.parse import urlsplit

import uvicorn
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY, read_json, write_json
from cadenza.report.html_pages import PLAYING, asset, rendered

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
    """The last address, None without one; raises CadenzaError if others may know it."""
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
    """Whether others own a file or have one of these permissions (bits of a mode)."""
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode):
        return True  # it may lead to a file of theirs
    return status.st_uid != os.getuid() or bool(status.st_mode & permissions)


def write_address(path: Path, address: Address) -> None:
    """Write a file that only this user can read."""
    path.touch(_PRIVATE)
    path.chmod(_PRIVATE)  # which the file that takes its place keeps
    write_json(path, asdict(address))


def announce(address: str, browser: bool = True, folder: Path | None = None) -> None:
    """Print the address of the page, and open it where there is a screen and `browser` is true.

    As other users of this machine can read the arguments of the browser, it opens a private file in
    `folder`, which leads on to the address and is deleted when this process ends.
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


_OWN = (
    *("requests.js", "instrument.js", "keyboard.js", "stream.js", "library.js", "player.js"),
    *("performances.js", "background.js", "studio.js"),
)
_KEEP_ALIVE = 5  # [s] that a connection without requests stays open
_SHUTDOWN_TIME = 2  # [s] that requests have to end when the server does
_MAX_RECEIVED = 1 << 12  # bytes of a message of the page, which has nothing to send
_KILLED = 128  # what shells add to the number of a signal that ends a process


def _own(name: str) -> str:
    """A file of the studio's own page."""
    return resources.files("cadenza.studio").joinpath("page", name).read_text("utf-8")


@cache
def page() -> str:
    """The page itself."""
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
    """Serve until the process is to end.

    Raises CadenzaError if the address is in use or does not exist, or others may have written the
    file.

    Args:
        app: makes the application from the token and the host.
        host, port: where to listen; port 0 is the one of the last time, or any.
        ready: is called with the address to open, which holds a random token.
        address_file: keeps token and port for the next time, so that links stay valid.
    """
    os.environ["PYTHONSAFEPATH"] = "1"  # no process of ours imports from the working folder
    address = None if address_file is None else read_address(address_file)
    token, last_port = astuple(address or Address(secrets.token_urlsafe(16), 0))
    with _bound_socket(host, [port] if port else [last_port, 0]) as listening:
        port = listening.getsockname()[1]
        if address_file is not None and address is None:
            write_address(address_file, Address(token, port))
        shown_host = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        shown_host = f"[{shown_host}]" if ":" in shown_host else shown_host
        ready(f"http://{shown_host}:{port}/{token}/")
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
    ended = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(_KILLED + number))
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, closed)
        signal.signal(signal.SIGTERM, ended)


_READING = ("GET", "HEAD")  # methods that change nothing
_POLICY_VIOLATION = 1008  # why a WebSocket is closed
_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src 'self' data: blob:; media-src 'self' blob:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}


class AccessControl:
    """An app behind the token: it sees requests whose path begins with it, without it.

    The Host must be this machine's name in the address bar, and no other domain that points here;
    requests that change something, and every WebSocket, must come from our own page.
    """

    def __init__(self, app: ASGIApp, token: str, host: str) -> None:
        self._app, self._token, self._host = app, token, host.lower()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif reason := self._reason_to_refuse(scope):
            await _refuse(reason, scope, receive, send)
        else:

            async def with_headers(message: Message) -> None:
                if message["type"] == "http.response.start":
                    headers = MutableHeaders(scope=message)
                    for name, value in _HEADERS.items():
                        headers.setdefault(name, value)
                await send(message)

            inner = {**scope, "root_path": f"{scope.get('root_path', '')}/{self._token}"}
            await self._app(inner, receive, with_headers)

    def _reason_to_refuse(self, scope: Scope) -> str:
        """The reason to refuse a request; empty if it is let through."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._is_ours(host):
            return "refused: this is no address of the studio"
        changes = scope["type"] == "websocket" or scope["method"] not in _READING
        if (origin is None and changes) or (origin is not None and origin != f"http://{host}"):
            return "refused: this request comes from another page"
        token = scope["path"].split("/", 2)[1] if scope["path"].startswith("/") else ""
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return "refused: open the address that `cadenza studio` has printed"
        return ""

    def _is_ours(self, host: str) -> bool:
        """Whether a host cannot be pointed elsewhere, such as a number or localhost."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in ("localhost", self._host):
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


async def _refuse(reason: str, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": reason})
    else:
        response = PlainTextResponse(f"{reason}\n", 403, _HEADERS | {"connection": "close"})
        await response(scope, receive, send)
