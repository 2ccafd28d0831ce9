"""Server of a page on which performances are watched as they are made."""

from __future__ import annotations

import asyncio
import os
import re
import secrets
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import astuple
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ExceptionHandler
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from cadenza.errors import CadenzaError
from cadenza.report.html_pages import asset, rendered
from cadenza.studio.access import AccessControl
from cadenza.studio.address import Address, announce, read_address, write_address
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.synthesizer import Synthesizer

_SHARED = (  # scripts, of reports as well
    *("elements.js", "recording.js", "rows.js", "flat.js", "falling.js", "stage.js", "chart.js"),
    *("arrangement.js", "explanations.js", "roll.js", "controls.js", "score.js"),
)
_OWN = (
    *("requests.js", "instrument.js", "keyboard.js", "stream.js", "library.js", "player.js"),
    *("performances.js", "background.js", "studio.js"),
)
_KEEP_ALIVE = 5  # [s] that a connection without requests stays open
_SHUTDOWN_TIME = 2  # [s] that requests have to end when the server does
_MAX_RECEIVED = 1 << 12  # bytes of a message of the page, which has nothing to send
_KILLED = 128  # what shells add to the number of a signal that ends a process
_FIRST_TONE = 60, 2  # middle C, made at the start: the process that makes tones is ready then
_CACHED = {"cache-control": "private, max-age=31536000, immutable"}


class PageServer:
    """A server of a page, and of performances that can be watched on it as they are made."""

    def __init__(self) -> None:
        self._synthesizer = Synthesizer()

    async def broadcast(self, id: str) -> Broadcast | None:
        """Return a performance by its id, or None if there is none."""
        raise NotImplementedError

    def routes(self) -> list[BaseRoute]:
        """Return all that the server answers."""
        return [
            Route("/", self.page),
            Route("/{name:str}.{ending:str}", self.script),
            Route("/tones/{pitch}/{band}", self.tone),
            WebSocketRoute("/watch/{id}", self.watch),
        ]

    def app(self, token: str, host: str) -> AccessControl:
        """Return the ASGI application, behind access control."""
        errors: dict[Any, ExceptionHandler] = dict.fromkeys((CadenzaError, OSError), _report_error)
        app = Starlette(routes=self.routes(), lifespan=self.lifespan, exception_handlers=errors)
        return AccessControl(app, token, host)

    @asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Run from the start of the server to its end."""
        first = asyncio.create_task(self._synthesizer.tone(*_FIRST_TONE))
        try:
            yield
        finally:
            first.cancel()
            await asyncio.wait({first})

    async def page(self, _: Request) -> Response:
        """Answer the page; its address must end in a slash, as its links are relative."""
        return Response(_page(), media_type="text/html")

    async def script(self, request: Request) -> Response:
        """Answer a style sheet or a script."""
        name = "{name}.{ending}".format(**request.path_params)
        if name not in _PARTS:
            return error_response("there is no such file", 404)
        kind, make = _PARTS[name]
        return Response(make(), media_type=kind)

    async def tone(self, request: Request) -> Response:
        """Answer the sound of a key, see `cadenza.studio.tone_samples`."""
        pitch, band = (_number(request.path_params[name]) for name in ("pitch", "band"))
        made = await self._synthesizer.tone(pitch, band)
        return Response(made, media_type="application/octet-stream", headers=_CACHED)

    async def watch(self, socket: WebSocket) -> None:
        """Send a performance from its beginning on, until it is over or the page has gone."""
        await socket.accept()
        tasks = [asyncio.create_task(self._send(socket)), asyncio.create_task(_closed(socket))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        with suppress(RuntimeError, WebSocketDisconnect):  # the page has gone
            await socket.close()

    async def _send(self, socket: WebSocket) -> None:
        if (broadcast := await self.broadcast(socket.path_params["id"])) is None:
            await socket.send_json({"state": "gone"})
        else:
            await broadcast.send_all(socket.send_text, socket.send_bytes)


async def _closed(socket: WebSocket) -> None:
    """Wait until the page has gone."""
    with suppress(WebSocketDisconnect, RuntimeError):
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass


async def _report_error(_: Request, error: Exception) -> Response:
    """Answer in one line what is wrong with a request, or with the disk."""
    if isinstance(error, OSError):
        return error_response(error.strerror or "the disk cannot be read or written", 500)
    return error_response(" ".join(str(error).split()), 400)


def error_response(message: str, status: int) -> Response:
    """Return a response that says in one line what is wrong."""
    return JSONResponse({"error": message}, status)


def _number(text: str) -> int:
    """Return a number of up to three digits; -1 for anything else, however long it is."""
    return int(text) if re.fullmatch("[0-9]{1,3}", text) else -1


def _own(name: str) -> str:
    """Return a file of the studio's own page."""
    return resources.files("cadenza.studio").joinpath("page", name).read_text("utf-8")


@cache
def _page() -> str:
    return rendered(_own("studio.html"))


@cache
def _scripts() -> str:
    parts = [*map(asset, _SHARED), *map(_own, _OWN)]
    return '"use strict";(async () => {\n' + "\n".join(parts) + "\n})();\n"


@cache
def _styles() -> str:
    # A sum would escape the quotes of our own.
    return "".join((asset("page.css"), asset("score.css"), _own("studio.css")))


_PARTS: dict[str, tuple[str, Callable[[], str]]] = {
    "studio.css": ("text/css", _styles),
    "studio.js": ("text/javascript", _scripts),
    "three.js": ("text/javascript", lambda: asset("three.min.js")),
}


def _bound_socket(host: str, ports: Sequence[int]) -> socket.socket:
    """Listen at the first of the ports that is free.

    Raises:
        CadenzaError: none is, or there is no such address.
    """
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
    page: PageServer,
    host: str = "127.0.0.1",
    port: int = 0,
    ready: Callable[[str], None] = announce,
    address_file: Path | None = None,
) -> None:
    """Serve until the process is told to end.

    Args:
        page: is served.
        host, port: where to listen; port 0 is the one of the last time, or any.
        ready: is called with the address to open, which holds a random token.
        address_file: keeps token and port for the next time, so that links stay valid.

    Raises:
        CadenzaError: somebody else listens there, there is no such address, or others may have
            written the file.
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
        app = page.app(token, host)
        ready(f"http://{shown}:{port}/{token}/")
        config = uvicorn.Config(
            app,
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
