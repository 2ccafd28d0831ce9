"""The studio's server: pages and files, requests to play, and what is played as it is made."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import socket
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, nullcontext, suppress
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from cadenza.agents.registry import AGENTS as REGISTERED
from cadenza.agents.registry import PLANNER
from cadenza.configs import MOST_COUNT, whole_number
from cadenza.errors import CadenzaError
from cadenza.files import parsed_json
from cadenza.hands.named import HANDS
from cadenza.report.asset import asset
from cadenza.studio.guard import Guard
from cadenza.studio.jobs import Job, Jobs
from cadenza.studio.limits import MOST_BYTES
from cadenza.studio.messages import ROWS
from cadenza.studio.processes import read_upload, write_comparison
from cadenza.studio.request import AGENTS, PLANNERS, PlayRequest, read_request
from cadenza.studio.shelf import FILES, Shelf, Upload
from cadenza.studio.trainings import Trainings

_MOST_JSON = 1 << 14  # bytes of a request
_READING_AT_ONCE = 2
_SHARED = (
    *("recording.js", "rows.js", "flat.js", "falling.js", "stage.js", "chart.js", "roll.js"),
    "controls.js",
)
_OWN = ("instrument.js", "keyboard.js", "stream.js", "studio.js")
_MOST_SENT = 1 << 18  # bytes of rows in a frame
_WATCHERS = 16  # at once
# Pages that were written bring their own policy; here they may not reach the studio either. One
# that compares looks into pages within it, which a sandbox would keep it from.
_ALONE = {"content-security-policy": "sandbox allow-scripts allow-downloads; connect-src 'none'"}
_COMPARING = {"content-security-policy": "connect-src 'none'; form-action 'none'; base-uri 'none'"}

Handler = Callable[[Request], Awaitable[Response]]


class Watchable:
    """A page, and performances that can be watched on it as they are made."""

    def __init__(self) -> None:
        self._watchers = 0

    @property
    def performing(self) -> Mapping[str, Job]:
        """Those that wait or play, and the last ones."""
        raise NotImplementedError

    def routes(self) -> list[BaseRoute]:
        """What is answered."""
        return [
            Route("/", self.page),
            Route("/{name:str}.{ending:str}", self.script),
            Route("/api/jobs", _plainly(self.list_jobs)),
            WebSocketRoute("/watch/{id}", self.watch),
        ]

    def app(self, token: str, host: str) -> Guard:
        """What answers; see `Guard`."""
        return Guard(Starlette(routes=self.routes(), lifespan=self.lifespan), token, host)

    def lifespan(self, _: Starlette) -> AbstractAsyncContextManager[None]:
        """What goes on while it answers."""
        return nullcontext()

    async def page(self, _: Request) -> Response:
        """The page; its address must end in a slash, so that what it names lies below."""
        return Response(_own("studio.html"), media_type="text/html")

    async def script(self, request: Request) -> Response:
        """Looks and scripts."""
        name = "{name}.{ending}".format(**request.path_params)
        if name not in _PARTS:
            return _error("there is no such file", 404)
        kind, make = _PARTS[name]
        return Response(make(), media_type=kind)

    async def list_jobs(self, _: Request) -> Response:
        """Those that wait or play, and the last ones."""
        return JSONResponse([job.summary for job in self.performing.values()])

    async def watch(self, socket: WebSocket) -> None:
        """Sends what a job has to tell, from its beginning on, until it is over."""
        job = self.performing.get(socket.path_params["id"])
        if self._watchers >= _WATCHERS:
            await socket.close(1013)
            return
        await socket.accept()
        if job is None:
            await socket.send_text(json.dumps({"state": "gone"}))
            await socket.close()
            return
        self._watchers += 1
        telling = asyncio.create_task(_tell(job, socket))
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


class Studio(Watchable):
    """All that the server of the studio knows."""

    def __init__(
        self, folder: Path, runs: Path = Path("runs"), at_once: int = 1, video: bool = True
    ) -> None:
        """Args:
            folder: where songs and performances are kept.
            runs: where policies learn, and those lie that have learnt.
            at_once: how many songs are played at the same time.
            video: whether one is made of each performance.

        Raises:
            OSError: the folder cannot be made.
        """
        super().__init__()
        self.shelf = Shelf(folder)
        self.jobs = Jobs(self.shelf.folder, Trainings(runs), at_once, video)
        self._hands = {name: name.capitalize() for name in HANDS.entries()}
        self._added = {
            name: f"{name} ({entry.about})"
            for name, entry in REGISTERED.entries().items()
            if name not in REGISTERED.own
        }
        self._reading = asyncio.Semaphore(_READING_AT_ONCE)

    @property
    def performing(self) -> Mapping[str, Job]:
        """See `Watchable`."""
        return self.jobs.jobs

    def routes(self) -> list[BaseRoute]:
        """See `Watchable`."""
        return [
            *super().routes(),
            Route("/api/songs", _plainly(self.songs)),
            Route("/api/songs", _plainly(self.upload), methods=["POST"]),
            Route("/api/songs/{id}", _plainly(self.forget), methods=["DELETE"]),
            Route("/api/jobs", _plainly(self.play), methods=["POST"]),
            Route("/api/jobs/{id}", _plainly(self.cancel), methods=["DELETE"]),
            Route("/api/background", _plainly(self.background)),
            Route("/api/practice", _plainly(self.stop_practice), methods=["DELETE"]),
            Route("/api/trainings", _plainly(self.train), methods=["POST"]),
            Route("/api/trainings/{name}/resume", _plainly(self.resume), methods=["POST"]),
            Route("/api/trainings/{name}/stop", _plainly(self.stop_training), methods=["POST"]),
            Route("/api/performances", _plainly(self.performances)),
            Route("/api/performances/{id}", _plainly(self.remove), methods=["DELETE"]),
            Route("/performances/{id}/{name}", _plainly(self.file)),
            Route("/comparisons/{first}/{second}", _plainly(self.compare)),
        ]

    @asynccontextmanager
    async def lifespan(self, _: Starlette) -> AsyncIterator[None]:
        """See `Watchable`."""
        await self.jobs.warm()
        try:
            yield
        finally:
            await self.jobs.close()

    async def songs(self, _: Request) -> Response:
        """What can be played, and who plays."""
        found = await run_in_threadpool(self.shelf.songs)
        agents = await run_in_threadpool(self._agents)
        return JSONResponse({"songs": found, "agents": agents, "hands": self._hands})

    def _agents(self) -> dict[str, str]:
        """Who can play, and what they are called on the page."""
        learnt = {agent: agent.replace("/", ": ", 1) for agent in self.jobs.trainings.policies()}
        return AGENTS | self._added | learnt

    async def upload(self, request: Request) -> Response:
        """Takes a file; its name, percent-encoded, is the parameter `name`."""
        content = await _body(request, MOST_BYTES, "the file")
        name = request.query_params.get("name", "")
        put = await run_in_threadpool(self.shelf.put, content, name)
        path, id, title, ending = put
        try:
            async with self._reading:
                holds = await read_upload(path)
        except CadenzaError:
            path.unlink(missing_ok=True)
            raise
        upload = Upload(id, title, ending, **holds)
        await run_in_threadpool(self.shelf.add, upload)
        return JSONResponse({"id": id, "title": title, **holds}, 201)

    async def forget(self, request: Request) -> Response:
        """Deletes an upload."""
        await run_in_threadpool(self.shelf.remove_upload, request.path_params["id"])
        return Response(status_code=204)

    async def play(self, request: Request) -> Response:
        """Has a song played."""
        content = await _body(request, _MOST_JSON, "the request")
        wanted = self._wanted(parsed_json(content, dict[str, Any], "request"))
        title, source, uploaded = await run_in_threadpool(self.shelf.source, wanted.song)
        agent = PLANNER if wanted.agent in PLANNERS else wanted.agent
        if (policy := self.jobs.trainings.policies().get(agent)) is not None:
            agent = str(policy)
        job = self.jobs.submit(wanted, title, source, uploaded, agent)
        return JSONResponse(job.summary, 201)

    def _wanted(self, content: dict[str, Any]) -> PlayRequest:
        return read_request(content, self._agents(), self._hands)

    async def cancel(self, request: Request) -> Response:
        """Ends a job."""
        self.jobs.cancel(request.path_params["id"])
        return Response(status_code=204)

    async def background(self, _: Request) -> Response:
        """What is practised, and who learns."""
        runs = await run_in_threadpool(self.jobs.trainings.runs)
        return JSONResponse({"practice": self.jobs.practice.summary, "trainings": runs})

    async def stop_practice(self, _: Request) -> Response:
        """Ends practice."""
        self.jobs.practice.stop()
        return Response(status_code=204)

    async def train(self, request: Request) -> Response:
        """Has a policy learn a song, in so many `steps`."""
        content = await _body(request, _MOST_JSON, "the request")
        asked = parsed_json(content, dict[str, Any], "request")
        steps = whole_number(asked.pop("steps", None), "steps", 1, MOST_COUNT)
        wanted = self._wanted(asked)
        title, source, _ = await run_in_threadpool(self.shelf.source, wanted.song)
        name = await self.jobs.trainings.begin(wanted, title, source, steps)
        return JSONResponse({"name": name}, 201)

    async def resume(self, request: Request) -> Response:
        """Has a run go on."""
        await self.jobs.trainings.go_on(request.path_params["name"])
        return Response(status_code=204)

    async def stop_training(self, request: Request) -> Response:
        """Has a run end after a checkpoint."""
        self.jobs.trainings.stop(request.path_params["name"])
        return Response(status_code=204)

    async def performances(self, _: Request) -> Response:
        """Those that are kept."""
        return JSONResponse(await run_in_threadpool(self.shelf.performances))

    async def remove(self, request: Request) -> Response:
        """Deletes a performance."""
        await run_in_threadpool(self.shelf.remove, request.path_params["id"])
        return Response(status_code=204)

    async def file(self, request: Request) -> Response:
        """A file of a performance."""
        name = request.path_params["name"]
        path = await run_in_threadpool(self.shelf.file, request.path_params["id"], name)
        headers = _ALONE if name == "report.html" else None
        return FileResponse(path, media_type=FILES[name], headers=headers)

    async def compare(self, request: Request) -> Response:
        """Two performances of a song on one page, which is made when it is first asked for."""
        ids = request.path_params["first"], request.path_params["second"]
        folders, page = await run_in_threadpool(self.shelf.comparison, *ids)
        if not page.exists():
            async with self._reading:
                await write_comparison(folders, page)
        return FileResponse(page, media_type="text/html; charset=utf-8", headers=_COMPARING)


async def _tell(job: Job, socket: WebSocket) -> None:
    about, tones, rows, status = False, 0, 0, None
    while True:
        changed = job.changed
        if status != job.status:
            status = job.status
            await socket.send_text(json.dumps(status))
        if not about and job.about is not None:
            about = True
            await socket.send_text(job.about.decode())
        while tones < len(job.tones):
            await socket.send_bytes(job.tones[tones])
            tones += 1
        while rows < len(job.rows):
            part = bytes(job.rows[rows : rows + _MOST_SENT])
            await socket.send_bytes(ROWS + part)
            rows += len(part)
        if job.is_over and status == job.status and rows == len(job.rows):
            return
        await changed.wait()


async def _until_gone(socket: WebSocket) -> None:
    """The page says nothing; whatever it sends is not read for long."""
    with suppress(WebSocketDisconnect, RuntimeError):
        while (await socket.receive())["type"] != "websocket.disconnect":
            pass


def _plainly(handle: Handler) -> Handler:
    """What is wrong is said in a line."""

    async def answer(request: Request) -> Response:
        try:
            return await handle(request)
        except CadenzaError as error:
            return _error(" ".join(str(error).split()), 400)
        except OSError as error:
            return _error(error.strerror or "the disk cannot be read or written", 500)

    return answer


def _error(message: str, status: int) -> Response:
    return JSONResponse({"error": message}, status)


async def _body(request: Request, most: int, what: str) -> bytes:
    """Raises: CadenzaError: it is larger."""
    too_large = CadenzaError(f"{what} is larger than {most / 2**20:.3g} MiB")
    length = request.headers.get("content-length", "0")
    if not length.isascii() or not length.isdigit() or int(length) > most:
        raise too_large
    content = bytearray()
    async for chunk in request.stream():
        content += chunk
        if len(content) > most:
            raise too_large
    return bytes(content)


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


def announce(address: str, browser: bool = True) -> None:
    """Says what to open, and opens it where there is a screen."""
    print(f"Open {address}", flush=True)
    if browser and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        webbrowser.open(address)


def serve(
    what: Watchable,
    host: str = "127.0.0.1",
    port: int = 0,
    ready: Callable[[str], None] = announce,
) -> None:
    """Serves until the process is told to end.

    Args:
        what: is served.
        host, port: where to listen; any free port by default.
        ready: is told the address to open, which holds a random token.

    Raises:
        CadenzaError: somebody else listens there, or there is no such address.
    """
    token = secrets.token_urlsafe(16)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listening = socket.create_server((host, port), family=family)
    except OSError as error:
        raise CadenzaError(f"cannot listen on {host}, port {port}: {error.strerror}") from error
    with listening:
        port = listening.getsockname()[1]
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
            limit_concurrency=64,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=2,
            ws_max_size=1 << 12,
        )
        uvicorn.Server(config).run(sockets=[listening])
