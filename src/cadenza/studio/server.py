"""The studio's server: songs, requests to play and practise them, and kept performances."""

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from inspect import isawaitable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.types import ExceptionHandler, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from cadenza.agents.registry import AGENTS as REGISTERED
from cadenza.errors import CadenzaError, errors_in
from cadenza.files import checked, parsed_json
from cadenza.music.formats.reading import check_format
from cadenza.music.formats.source import printable
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.jobs import JobQueue
from cadenza.studio.limits import MAX_BYTES
from cadenza.studio.page_server import PARTS, AccessControl, page
from cadenza.studio.processes import opening_picture, read_upload
from cadenza.studio.request import AGENTS, hand_titles, read_request
from cadenza.studio.storage import FILES, Storage, Upload
from cadenza.studio.tone_samples import Synthesizer

_FIRST_SONG = "FurEliseOpening"  # on the page when it opens
_FIRST_TONE = 60, 2  # middle C, made at the start, so that the process for tones is ready
_CACHED = {"cache-control": "private, max-age=31536000, immutable"}
_MAX_NAME = 255  # letters of the name of a file, as most file systems have it
_MAX_JSON = 1 << 14  # bytes of a request
_MAX_READING = 2  # files at once
RECEIVE_TIME = 60.0  # [s] for all of a request to arrive
# Reports bring their own policy; here they may not reach the studio either.
_ALLOWED = "allow-scripts allow-downloads allow-modals"  # the last to print
_REPORT = {"content-security-policy": f"sandbox {_ALLOWED}; connect-src 'none'"}


class StoredFile(FileResponse):
    """A file that may be deleted before it has been sent."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        has_begun = False

        async def send_and_note(message: Message) -> None:
            nonlocal has_begun
            has_begun = True
            await send(message)

        try:
            await super().__call__(scope, receive, send_and_note)
        except (OSError, RuntimeError):  # how Starlette says that it is not there
            if not has_begun:
                await error_response("there is no such file", 404)(scope, receive, send)


class Studio:
    """The studio: songs, jobs, practice, and performances that are kept."""

    def __init__(self, folder: Path, at_once: int = 1) -> None:
        """Open the folder of a studio that plays `at_once` songs, or raise OSError."""
        self._synthesizer = Synthesizer()
        self.storage = Storage(folder)
        self.jobs = JobQueue(self.storage.folder, at_once)
        self._hands = hand_titles()
        self._agents = AGENTS | {
            name: (name, f"{entry.about[:1].upper()}{entry.about[1:]}.")
            for name, entry in REGISTERED.entries().items()
            if name not in REGISTERED.own
        }
        self._reading = asyncio.Semaphore(_MAX_READING)
        self._opening: asyncio.Task[bytes] | None = None

    async def broadcast(self, id: str) -> Broadcast | None:
        """A job or a performance that is kept; None if there is none of this id."""
        if id in self.jobs.jobs:
            return self.jobs.jobs[id]
        try:
            return await run_in_threadpool(self.storage.broadcast, id)
        except (CadenzaError, OSError):
            return None

    def routes(self) -> list[BaseRoute]:
        """The routes of the server."""
        storage, jobs = self.storage, self.jobs
        remove = storage.remove_performance
        return [
            Route("/", self.page),
            Route("/{name:str}.{ending:str}", self.script),
            Route("/tones/{pitch}/{band}", self.tone),
            WebSocketRoute("/watch/{id}", self.watch),
            Route("/api/songs", self.songs),
            Route("/api/songs", self.upload, methods=["POST"]),
            Route("/api/songs/{id}", _in_thread(storage.remove_upload), methods=["DELETE"]),
            Route("/api/opening", self.opening),
            Route("/api/jobs", self.play, methods=["POST"]),
            Route("/api/jobs/{id}", _action(jobs.cancel), methods=["DELETE"]),
            Route("/api/background", self.background),
            Route("/api/practice", _action(jobs.practice.stop), methods=["DELETE"]),
            Route("/api/performances", self.performances),
            Route("/api/performances/{id}", _in_thread(remove), methods=["DELETE"]),
            Route("/performances/{id}/{name}", self.file),
        ]

    def app(self, token: str, host: str) -> AccessControl:
        """The ASGI application, behind access control."""
        errors: dict[Any, ExceptionHandler] = dict.fromkeys((CadenzaError, OSError), _report_error)
        app = Starlette(routes=self.routes(), lifespan=self.lifespan, exception_handlers=errors)
        return AccessControl(app, token, host)

    @asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """Keep a player ready from the start of the server to its end."""
        first = asyncio.create_task(self._synthesizer.tone(*_FIRST_TONE))
        await self.jobs.start_player()
        try:
            yield
        finally:
            await self.jobs.close()
            first.cancel()
            await asyncio.wait({first})

    async def page(self, _: Request) -> Response:
        """Answer the page; its address must end in a slash, as its links are relative."""
        return Response(page(), media_type="text/html")

    async def script(self, request: Request) -> Response:
        """Answer a style sheet or a script."""
        name = "{name}.{ending}".format(**request.path_params)
        if name not in PARTS:
            return error_response("there is no such file", 404)
        kind, make = PARTS[name]
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

    def songs(self, _: Request) -> Response:
        """List songs, agents and hands, and the song with which the page opens."""
        choices = {"songs": self.storage.songs(), "agents": self._agents, "hands": self._hands}
        return JSONResponse(choices | {"first": _FIRST_SONG})

    async def opening(self, _: Request) -> Response:
        """Answer the first picture of the page, of `_FIRST_SONG`; null if none is made."""
        if self._opening is None:  # made once
            self._opening = asyncio.create_task(opening_picture(_FIRST_SONG))
        picture = await asyncio.shield(self._opening)
        return Response(picture or b"null", media_type="application/json")

    async def upload(self, request: Request) -> Response:
        """Take a file; its name, percent-encoded, is the parameter `name`."""
        name = printable(request.query_params.get("name", "")[-_MAX_NAME:])
        check_format(Path(name))  # whatever its size
        content = await _body(request, MAX_BYTES, name or "the file")
        write = self.storage.write_upload
        path, id, title, ending = await run_in_threadpool(write, content, name)
        del content  # others may be read before it
        try:
            with errors_in(name or "the file"):
                async with self._reading:
                    contents = await read_upload(path)
        except CadenzaError:
            if not self.storage.is_listed(id):  # else the same file has been read before
                path.unlink(missing_ok=True)
            raise
        title = contents.pop("title") or title
        facts = {"id": id, "title": title, "ending": ending, **contents}
        upload = checked(facts, Upload, name or "the file")
        await run_in_threadpool(self.storage.list_upload, upload)
        return JSONResponse({"id": id, "title": title, **contents}, 201)

    async def play(self, request: Request) -> Response:
        """Add a job that plays a song."""
        content = await _body(request, _MAX_JSON, "the request")
        options = parsed_json(content, dict[str, Any], "request")
        play_request = read_request(options, self._agents, self._hands)
        title, source, uploaded = await run_in_threadpool(self.storage.source, play_request.song)
        job = self.jobs.submit(play_request, title, source, uploaded)
        return JSONResponse(job.summary, 201)

    async def background(self, _: Request) -> Response:
        """List practice, and jobs that play or wait."""
        jobs = [job.summary for job in self.jobs.jobs.values() if not job.is_over]
        return JSONResponse({"practice": self.jobs.practice.summary, "jobs": jobs})

    def performances(self, _: Request) -> Response:
        """List the performances that are kept."""
        return JSONResponse(self.storage.performances())

    def file(self, request: Request) -> Response:
        """Answer a file of a performance."""
        name = request.path_params["name"]
        path = self.storage.file(request.path_params["id"], name)
        headers = _REPORT if name == "report.html" else None
        return StoredFile(path, media_type=FILES[name], headers=headers)


async def _closed(socket: WebSocket) -> None:
    """Wait until the page has gone."""
    with suppress(WebSocketDisconnect, RuntimeError):
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass


async def _report_error(_: Request, error: Exception) -> Response:
    """Answer an error of a request, or of the disk, in one line."""
    if isinstance(error, OSError):
        return error_response(error.strerror or "the disk cannot be read or written", 500)
    return error_response(" ".join(str(error).split()), 400)


def error_response(message: str, status: int) -> Response:
    """A response with an error in one line."""
    return JSONResponse({"error": message}, status)


def _number(text: str) -> int:
    """A number of up to three digits; -1 for anything else, however long it is."""
    return int(text) if re.fullmatch("[0-9]{1,3}", text) else -1


def _action(work: Callable[..., Any]) -> Callable[[Request], Awaitable[Response]]:
    """An endpoint that calls `work` with the parameters of the path."""

    async def endpoint(request: Request) -> Response:
        result = work(**request.path_params)
        if isawaitable(result):
            await result
        return Response(status_code=204)

    return endpoint


def _in_thread(work: Callable[..., Any]) -> Callable[[Request], Awaitable[Response]]:
    """An endpoint as `_action` does; the work is on files, and done in a thread."""
    return _action(lambda **names: run_in_threadpool(work, **names))


async def _body(request: Request, max_bytes: int, name: str) -> bytes:
    """Receive the body of a request, of up to `max_bytes`; `name` stands in errors.

    Raises CadenzaError if the body is larger, or does not arrive.
    """
    too_large = CadenzaError(f"{name} is larger than {max_bytes / 2**20:.3g} MiB")
    length = request.headers.get("content-length", "0")
    if not re.fullmatch("[0-9]{1,15}", length) or int(length) > max_bytes:
        raise too_large
    content = bytearray()
    try:
        async with asyncio.timeout(RECEIVE_TIME):
            async for chunk in request.stream():
                content += chunk
                if len(content) > max_bytes:
                    raise too_large
    except TimeoutError as error:
        raise CadenzaError(f"{name} takes too long to come") from error
    except ClientDisconnect as error:
        raise CadenzaError(f"{name} has not come to its end") from error
    return bytes(content)
