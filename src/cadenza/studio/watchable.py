"""A page on which performances are watched as they are made, and how it is served."""

from __future__ import annotations

import asyncio
import re
import secrets
import signal
import socket
import sys
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import (
    AbstractContextManager,
    asynccontextmanager,
    contextmanager,
    nullcontext,
    suppress,
)
from dataclasses import astuple
from functools import cache
from importlib import resources
from pathlib import Path

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from cadenza.errors import CadenzaError
from cadenza.report.html_pages import asset
from cadenza.studio.address import Address, announce, keep
from cadenza.studio.address import known as known_address
from cadenza.studio.guard import Guard
from cadenza.studio.sockets import Telling
from cadenza.studio.stream import Stream
from cadenza.studio.synthesizer import Synthesizer

_SHARED = (
    *("recording.js", "rows.js", "flat.js", "falling.js", "stage.js", "chart.js", "roll.js"),
    "controls.js",
)
_OWN = (
    *("asking.js", "instrument.js", "keyboard.js", "stream.js", "library.js", "player.js"),
    *("kept.js", "background.js", "studio.js"),
)
_MOST_WATCHERS = 16  # at once
_FOR_LONG = {"cache-control": "private, max-age=31536000, immutable"}

Handler = Callable[[Request], Awaitable[Response]]


class Watchable:
    """A page, and performances that can be watched on it as they are made."""

    def __init__(self) -> None:
        self._watchers = 0
        self._synthesizer = Synthesizer()

    async def stream(self, id: str) -> Stream | None:
        """A performance by its id, if there is one."""
        raise NotImplementedError

    def watching(self, stream: Stream) -> AbstractContextManager[None]:
        """While a page watches it."""
        return nullcontext()

    def routes(self) -> list[BaseRoute]:
        """What is answered."""
        return [
            Route("/", self.page),
            Route("/{name:str}.{ending:str}", self.script),
            Route("/tones/{pitch}/{band}", plainly(self.tone)),
            WebSocketRoute("/watch/{id}", self.watch),
        ]

    def app(self, token: str, host: str) -> Guard:
        """What answers; see `Guard`."""
        return Guard(Starlette(routes=self.routes(), lifespan=self.lifespan), token, host)

    @asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """What goes on while it answers."""
        await self._synthesizer.warm()
        try:
            yield
        finally:
            await self._synthesizer.close()

    async def page(self, _: Request) -> Response:
        """The page; its address must end in a slash, so that what it names lies below."""
        return Response(_own("studio.html"), media_type="text/html")

    async def script(self, request: Request) -> Response:
        """Looks and scripts."""
        name = "{name}.{ending}".format(**request.path_params)
        if name not in _PARTS:
            return refusal("there is no such file", 404)
        kind, make = _PARTS[name]
        return Response(make(), media_type=kind)

    async def tone(self, request: Request) -> Response:
        """How a key sounds, see `cadenza.studio.tones`."""
        pitch, band = (_number(request.path_params[name]) for name in ("pitch", "band"))
        made = await self._synthesizer.tone(pitch, band)
        return Response(made, media_type="application/octet-stream", headers=_FOR_LONG)

    async def watch(self, socket: WebSocket) -> None:
        """Sends what there is to tell of a performance, from its beginning on, until it is over."""
        await socket.accept()
        self._watchers += 1
        telling = asyncio.create_task(self._tell(socket))
        listening = asyncio.create_task(_until_gone(socket))
        try:
            await asyncio.wait((telling, listening), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._watchers -= 1
            for task in telling, listening:
                task.cancel()
            await asyncio.gather(telling, listening, return_exceptions=True)
        with suppress(RuntimeError, WebSocketDisconnect):  # the page has gone
            await socket.close()

    async def _tell(self, socket: WebSocket) -> None:
        if self._watchers > _MOST_WATCHERS:
            error = f"{_MOST_WATCHERS} pages watch already; close one of them"
            await socket.send_json({"state": "full", "error": error})
        elif (stream := await self.stream(socket.path_params["id"])) is None:
            await socket.send_json({"state": "gone"})
        else:
            with self.watching(stream):
                await stream.tell(socket.send_text, socket.send_bytes)


async def _until_gone(socket: WebSocket) -> None:
    """The page says nothing; whatever it sends is not read for long."""
    with suppress(WebSocketDisconnect, RuntimeError):
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass


def plainly(handle: Handler) -> Handler:
    """What is wrong is said in a line."""

    async def answer(request: Request) -> Response:
        try:
            return await handle(request)
        except CadenzaError as error:
            return refusal(" ".join(str(error).split()), 400)
        except OSError as error:
            return refusal(error.strerror or "the disk cannot be read or written", 500)

    return answer


def refusal(message: str, status: int) -> Response:
    """A line that says what is wrong."""
    return JSONResponse({"error": message}, status)


def _number(text: str) -> int:
    """One of three digits at most; -1 for what is none, however long it is."""
    return int(text) if re.fullmatch("[0-9]{1,3}", text) else -1


def _own(name: str) -> str:
    return resources.files("cadenza.studio").joinpath("page", name).read_text("utf-8")


@cache
def _scripts() -> str:
    parts = [*map(asset, _SHARED), *map(_own, _OWN)]
    return '"use strict";(async () => {\n' + "\n".join(parts) + "\n})();\n"


@cache
def _looks() -> str:
    return asset("page.css") + _own("studio.css")


_PARTS: dict[str, tuple[str, Callable[[], str]]] = {
    "studio.css": ("text/css", _looks),
    "studio.js": ("text/javascript", _scripts),
    "three.js": ("text/javascript", lambda: asset("three.min.js")),
}


def _listening(host: str, ports: Sequence[int]) -> socket.socket:
    """At the first of the ports that is free.

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


def serve(
    what: Watchable,
    host: str = "127.0.0.1",
    port: int = 0,
    ready: Callable[[str], None] = announce,
    known: Path | None = None,
) -> None:
    """Serves until the process is told to end.

    Args:
        what: is served.
        host, port: where to listen; port 0 is the one of the last time, or any.
        ready: is told the address to open, which holds a random token.
        known: a file that keeps token and port for the next time, so that links stay valid.

    Raises:
        CadenzaError: somebody else listens there, there is no such address, or others may have
            written the file.
    """
    kept = None if known is None else known_address(known)
    token, before = astuple(kept or Address(secrets.token_urlsafe(16), 0))
    with _listening(host, [port] if port else [before, 0]) as listening:
        port = listening.getsockname()[1]
        if known is not None and kept is None:
            keep(known, Address(token, port))
        shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        shown = f"[{shown}]" if ":" in shown else shown
        app = what.app(token, host)
        ready(f"http://{shown}:{port}/{token}/")
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            date_header=False,
            http=app.strangers.protocol(),
            ws=Telling,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=2,
            ws_max_size=1 << 12,
            ws_per_message_deflate=False,  # it goes no further than this machine, mostly
        )
        server = uvicorn.Server(config)
        with _ending_in_order(server):
            server.run(sockets=[listening])


@contextmanager
def _ending_in_order(server: uvicorn.Server) -> Iterator[None]:
    """Has a terminal that closes be as Ctrl-C, and what is temporary go however the server is told.

    Else the processes that work for the server would be left behind, and a file with its address.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {signal.SIGTERM: signal.signal(signal.SIGTERM, _exit)}  # to which Uvicorn comes back
    if hasattr(signal, "SIGHUP"):  # which only Unix has
        closed = signal.signal(signal.SIGHUP, lambda *_: server.handle_exit(signal.SIGTERM, None))
        before[signal.SIGHUP] = closed
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _exit(number: int, _: object) -> None:
    sys.exit(128 + number)  # as of a process that a signal ends
