"""The studio's server: songs, requests to play, practise and learn them, and what is kept."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import Message, Receive, Scope, Send

from cadenza.agents.registry import AGENTS as REGISTERED
from cadenza.agents.registry import PLANNER
from cadenza.configs import MOST_COUNT, whole_number
from cadenza.errors import CadenzaError
from cadenza.files import checked, parsed_json
from cadenza.hands.registry import HANDS
from cadenza.music.formats.reading import check_format
from cadenza.studio.jobs import Job, Jobs
from cadenza.studio.limits import MOST_BYTES
from cadenza.studio.processes import read_upload, write_comparison
from cadenza.studio.request import AGENTS, PLANNERS, PlayRequest, read_request
from cadenza.studio.shelf import FILES, Shelf, Upload
from cadenza.studio.stream import Stream
from cadenza.studio.trainings import Trainings
from cadenza.studio.watchable import Watchable, plainly, refusal

_LEARNT = "A policy that has learnt on this machine."
_LONGEST_NAME = 255  # of a file, as most file systems have it
_MOST_JSON = 1 << 14  # bytes of a request
_RECEIVING_AT_ONCE, _READING_AT_ONCE = 4, 2  # files
_PATIENCE = 60.0  # [s] for all of a request to come
# Pages that were written bring their own policy; here they may not reach the studio either. One
# that compares looks into pages within it, which a sandbox would keep it from.
_ALONE = {"content-security-policy": "sandbox allow-scripts allow-downloads; connect-src 'none'"}
_COMPARING = {"content-security-policy": "connect-src 'none'; form-action 'none'; base-uri 'none'"}


class Sent(FileResponse):
    """A file that may be deleted before it has been sent."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        begun = False

        async def noting(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await super().__call__(scope, receive, noting)
        except (OSError, RuntimeError):  # how Starlette says that it is not there
            if not begun:
                await refusal("there is no such file", 404)(scope, receive, send)


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
            name: (name, f"{entry.about[:1].upper()}{entry.about[1:]}.")
            for name, entry in REGISTERED.entries().items()
            if name not in REGISTERED.own
        }
        self._receiving = list[asyncio.Timeout]()
        self._reading = asyncio.Semaphore(_READING_AT_ONCE)

    async def stream(self, id: str) -> Stream | None:
        """See `Watchable`."""
        if id in self.jobs.jobs:
            return self.jobs.jobs[id]
        try:
            return await run_in_threadpool(self.shelf.stream, id)
        except (CadenzaError, OSError):
            return None

    def watching(self, stream: Stream) -> AbstractContextManager[None]:
        """See `Watchable`; who is watched plays first."""
        return self.jobs.watching(stream) if isinstance(stream, Job) else nullcontext()

    def routes(self) -> list[BaseRoute]:
        """See `Watchable`."""
        return [
            *super().routes(),
            Route("/api/songs", plainly(self.songs)),
            Route("/api/songs", plainly(self.upload), methods=["POST"]),
            Route("/api/songs/{id}", plainly(self.forget), methods=["DELETE"]),
            Route("/api/jobs", plainly(self.play), methods=["POST"]),
            Route("/api/jobs/{id}", plainly(self.cancel), methods=["DELETE"]),
            Route("/api/background", plainly(self.background)),
            Route("/api/practice", plainly(self.stop_practice), methods=["DELETE"]),
            Route("/api/trainings", plainly(self.train), methods=["POST"]),
            Route("/api/trainings/{name}/resume", plainly(self.resume), methods=["POST"]),
            Route("/api/trainings/{name}/stop", plainly(self.stop_training), methods=["POST"]),
            Route("/api/performances", plainly(self.performances)),
            Route("/api/performances/{id}", plainly(self.remove), methods=["DELETE"]),
            Route("/performances/{id}/{name}", plainly(self.file)),
            Route("/comparisons/{first}/{second}", plainly(self.compare)),
        ]

    @asynccontextmanager
    async def lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """See `Watchable`."""
        async with super().lifespan(app):
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

    def _agents(self) -> dict[str, tuple[str, str]]:
        """Who can play, what they are called on the page, and what they do."""
        policies = self.jobs.trainings.policies()
        learnt = {agent: (agent.replace("/", ": ", 1), _LEARNT) for agent in policies}
        return AGENTS | self._added | learnt

    async def upload(self, request: Request) -> Response:
        """Takes a file; its name, percent-encoded, is the parameter `name`."""
        name = request.query_params.get("name", "")[-_LONGEST_NAME:]
        check_format(Path(name))  # whatever its size
        content = await _body(request, MOST_BYTES, "the file", self._receiving)
        path, id, title, ending = await run_in_threadpool(self.shelf.put, content, name)
        del content  # others may be read before it
        try:
            async with self._reading:
                holds = await read_upload(path)
        except CadenzaError:
            if not self.shelf.is_listed(id):  # else it has been read before, and is the same
                path.unlink(missing_ok=True)
            raise
        about = {"id": id, "title": title, "ending": ending, **holds}
        await run_in_threadpool(self.shelf.add, checked(about, Upload, "the file"))
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
        """What is practised, who learns, and what is played or waits its turn."""
        runs = await run_in_threadpool(self.jobs.trainings.runs)
        jobs = [job.summary for job in self.jobs.jobs.values() if not job.is_over]
        practice = self.jobs.practice.summary
        return JSONResponse({"practice": practice, "trainings": runs, "jobs": jobs})

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
        return Sent(path, media_type=FILES[name], headers=headers)

    async def compare(self, request: Request) -> Response:
        """Two performances of a song on one page, which is made when it is first asked for."""
        ids = request.path_params["first"], request.path_params["second"]
        folders, page = await run_in_threadpool(self.shelf.comparison, *ids)
        if not page.exists():
            async with self._reading:
                await write_comparison(folders, page)
        return Sent(page, media_type="text/html; charset=utf-8", headers=_COMPARING)


async def _body(
    request: Request, most: int, what: str, receiving: list[asyncio.Timeout] | None = None
) -> bytes:
    """All of it.

    Args:
        request: brings it.
        most: bytes that it may have.
        what: it is called.
        receiving: those that come at the same time. Where there is one too many, the first is given
            up: it had the most time, and must not keep others out.

    Raises:
        CadenzaError: it is larger, or does not come.
    """
    too_large = CadenzaError(f"{what} is larger than {most / 2**20:.3g} MiB")
    length = request.headers.get("content-length", "0")
    if not re.fullmatch("[0-9]{1,15}", length) or int(length) > most:  # Python reads no longer ones
        raise too_large
    content, receiving = bytearray(), [] if receiving is None else receiving
    try:
        async with asyncio.timeout(_PATIENCE) as patience:
            receiving.append(patience)
            if len(receiving) > _RECEIVING_AT_ONCE and not (first := receiving.pop(0)).expired():
                first.reschedule(0)
            async for chunk in request.stream():
                content += chunk
                if len(content) > most:
                    raise too_large
    except TimeoutError as error:
        raise CadenzaError(f"{what} takes too long to come") from error
    except ClientDisconnect as error:
        raise CadenzaError(f"{what} has not come to its end") from error
    finally:
        with suppress(ValueError):
            receiving.remove(patience)
    return bytes(content)
