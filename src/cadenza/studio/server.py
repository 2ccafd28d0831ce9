"""The studio's server: songs, requests to play, practise and learn them, and what is kept."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AbstractContextManager, asynccontextmanager, nullcontext, suppress
from inspect import isawaitable
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
from cadenza.configs import MAX_COUNT, whole_number
from cadenza.errors import CadenzaError, errors_in
from cadenza.files import checked, parsed_json
from cadenza.music.formats.reading import check_format
from cadenza.music.formats.titles import printable
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.jobs import Job, JobQueue
from cadenza.studio.limits import MAX_BYTES
from cadenza.studio.page_server import PageServer, error_response
from cadenza.studio.processes import opening_picture, read_upload, write_comparison
from cadenza.studio.request import AGENTS, PLANNER_VARIANTS, PlayRequest, hand_titles, read_request
from cadenza.studio.storage import FILES, Storage, Upload
from cadenza.studio.training_runs import TrainingRuns

_FIRST_SONG = "FurEliseOpening"  # with which the page opens
_LEARNT = "A policy that has learnt on this machine."
_MAX_NAME = 255  # letters of the name of a file, as most file systems have it
_MAX_JSON = 1 << 14  # bytes of a request
_MAX_RECEIVING, _MAX_READING = 4, 2  # files at once
RECEIVE_TIME = 60.0  # [s] for all of a request to arrive
# Reports bring their own policy; here they may not reach the studio either. A comparison looks into
# the pages within it, which a sandbox would prevent.
_ALLOWED = "allow-scripts allow-downloads allow-modals"  # the last to print
_REPORT = {"content-security-policy": f"sandbox {_ALLOWED}; connect-src 'none'"}
_COMPARISON = {"content-security-policy": "connect-src 'none'; form-action 'none'; base-uri 'none'"}


class StoredFile(FileResponse):
    """Sends a file that may be deleted before it has been sent."""

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


class Studio(PageServer):
    """Serves the studio: songs, jobs, practice, training, and performances that are kept."""

    def __init__(
        self, folder: Path, runs: Path = Path("runs"), at_once: int = 1, video: bool = False
    ) -> None:
        """Args:
            folder: where songs and performances are kept.
            runs: where policies learn, and those that have learnt are found.
            at_once: how many songs are played at the same time.
            video: whether to make a film of each performance.

        Raises:
            OSError: the folder cannot be made.
        """
        super().__init__()
        self.storage = Storage(folder)
        self.jobs = JobQueue(self.storage.folder, TrainingRuns(runs), at_once, video)
        self._hands = hand_titles()
        self._added = {
            name: (name, f"{entry.about[:1].upper()}{entry.about[1:]}.")
            for name, entry in REGISTERED.entries().items()
            if name not in REGISTERED.own
        }
        self._receiving = list[asyncio.Timeout]()
        self._reading = asyncio.Semaphore(_MAX_READING)
        self._opening: asyncio.Task[bytes] | None = None

    async def broadcast(self, id: str) -> Broadcast | None:
        """Returns a job or a performance that is kept; None if there is none of this id."""
        if id in self.jobs.jobs:
            return self.jobs.jobs[id]
        try:
            return await run_in_threadpool(self.storage.broadcast, id)
        except (CadenzaError, OSError):
            return None

    def watching(self, broadcast: Broadcast) -> AbstractContextManager[None]:
        """Counts a page among those that watch a job: watched jobs play first."""
        return self.jobs.watching(broadcast) if isinstance(broadcast, Job) else nullcontext()

    def routes(self) -> list[BaseRoute]:
        """Returns all that the server answers."""
        storage, jobs, trainings = self.storage, self.jobs, self.jobs.trainings
        remove = storage.remove_performance
        return [
            *super().routes(),
            Route("/api/songs", self.songs),
            Route("/api/songs", self.upload, methods=["POST"]),
            Route("/api/songs/{id}", _in_thread(storage.remove_upload), methods=["DELETE"]),
            Route("/api/opening", self.opening),
            Route("/api/jobs", self.play, methods=["POST"]),
            Route("/api/jobs/{id}", _action(jobs.cancel), methods=["DELETE"]),
            Route("/api/background", self.background),
            Route("/api/practice", _action(jobs.practice.stop), methods=["DELETE"]),
            Route("/api/trainings", self.train, methods=["POST"]),
            Route("/api/trainings/{name}/resume", _action(trainings.resume), methods=["POST"]),
            Route("/api/trainings/{name}/stop", _action(trainings.stop), methods=["POST"]),
            Route("/api/performances", self.performances),
            Route("/api/performances/{id}", _in_thread(remove), methods=["DELETE"]),
            Route("/performances/{id}/{name}", self.file),
            Route("/comparisons/{first}/{second}", self.compare),
        ]

    @asynccontextmanager
    async def lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """Keeps a player ready from the start of the server to its end."""
        async with super().lifespan(app):
            await self.jobs.start_player()
            try:
                yield
            finally:
                await self.jobs.close()

    def songs(self, _: Request) -> Response:
        """Lists songs, agents and hands, and says with which song the page opens."""
        about = {"songs": self.storage.songs(), "agents": self._agents(), "hands": self._hands}
        return JSONResponse(about | {"first": _FIRST_SONG})

    def _agents(self) -> dict[str, tuple[str, str]]:
        """Returns the agents by name: their titles on the page, and what they do."""
        policies = self.jobs.trainings.policies()
        learnt = {agent: (agent.replace("/", ": ", 1), _LEARNT) for agent in policies}
        return AGENTS | self._added | learnt

    async def opening(self, _: Request) -> Response:
        """Answers the picture with which the page opens, of `_FIRST_SONG`; null if none is made."""
        if self._opening is None:  # made once
            self._opening = asyncio.create_task(opening_picture(_FIRST_SONG))
        picture = await asyncio.shield(self._opening)
        return Response(picture or b"null", media_type="application/json")

    async def upload(self, request: Request) -> Response:
        """Takes a file; its name, percent-encoded, is the parameter `name`."""
        name = printable(request.query_params.get("name", "")[-_MAX_NAME:])
        check_format(Path(name))  # whatever its size
        content = await _body(request, MAX_BYTES, name or "the file", self._receiving)
        write = self.storage.write_upload
        path, id, title, ending = await run_in_threadpool(write, content, name)
        del content  # others may be read before it
        try:
            with errors_in(name or "the file"):
                async with self._reading:
                    contents = await read_upload(path)
        except CadenzaError:
            if not self.storage.is_listed(id):  # else it has been read before, and is the same
                path.unlink(missing_ok=True)
            raise
        title = contents.pop("title") or title
        about = {"id": id, "title": title, "ending": ending, **contents}
        upload = checked(about, Upload, name or "the file")
        await run_in_threadpool(self.storage.list_upload, upload)
        return JSONResponse({"id": id, "title": title, **contents}, 201)

    async def play(self, request: Request) -> Response:
        """Adds a job that plays a song."""
        content = await _body(request, _MAX_JSON, "the request")
        wanted = self._play_request(parsed_json(content, dict[str, Any], "request"))
        title, source, uploaded = await run_in_threadpool(self.storage.source, wanted.song)
        agent = PLANNER if wanted.agent in PLANNER_VARIANTS else wanted.agent
        if (policy := self.jobs.trainings.policies().get(agent)) is not None:
            agent = str(policy)
        job = self.jobs.submit(wanted, title, source, uploaded, agent)
        return JSONResponse(job.summary, 201)

    def _play_request(self, content: dict[str, Any]) -> PlayRequest:
        return read_request(content, self._agents(), self._hands)

    async def background(self, _: Request) -> Response:
        """Lists practice, training runs, and jobs that play or wait."""
        runs = await run_in_threadpool(self.jobs.trainings.runs)
        jobs = [job.summary for job in self.jobs.jobs.values() if not job.is_over]
        practice = self.jobs.practice.summary
        return JSONResponse({"practice": practice, "trainings": runs, "jobs": jobs})

    async def train(self, request: Request) -> Response:
        """Trains a policy on a song, for so many `steps`."""
        content = await _body(request, _MAX_JSON, "the request")
        asked = parsed_json(content, dict[str, Any], "request")
        steps = whole_number(asked.pop("steps", None), "steps", 1, MAX_COUNT)
        wanted = self._play_request(asked)
        title, source, _ = await run_in_threadpool(self.storage.source, wanted.song)
        name = await self.jobs.trainings.begin(wanted, title, source, steps)
        return JSONResponse({"name": name}, 201)

    def performances(self, _: Request) -> Response:
        """Lists the performances that are kept."""
        return JSONResponse(self.storage.performances())

    def file(self, request: Request) -> Response:
        """Answers a file of a performance."""
        name = request.path_params["name"]
        path = self.storage.file(request.path_params["id"], name)
        headers = _REPORT if name == "report.html" else None
        return StoredFile(path, media_type=FILES[name], headers=headers)

    async def compare(self, request: Request) -> Response:
        """Answers a page that compares two performances, made when it is first asked for."""
        ids = request.path_params["first"], request.path_params["second"]
        folders, page = await run_in_threadpool(self.storage.comparison, *ids)
        if not page.exists():
            async with self._reading:
                await write_comparison(folders, page)
        return StoredFile(page, media_type="text/html; charset=utf-8", headers=_COMPARISON)


def _action(work: Callable[..., Any]) -> Callable[[Request], Awaitable[Response]]:
    """Returns an endpoint that calls `work` with the parameters of the path."""

    async def endpoint(request: Request) -> Response:
        result = work(**request.path_params)
        if isawaitable(result):
            await result
        return Response(status_code=204)

    return endpoint


def _in_thread(work: Callable[..., Any]) -> Callable[[Request], Awaitable[Response]]:
    """Returns an endpoint as `_action` does; the work is on files, and done in a thread."""
    return _action(lambda **names: run_in_threadpool(work, **names))


async def _body(
    request: Request, most: int, what: str, receiving: list[asyncio.Timeout] | None = None
) -> bytes:
    """Returns the body of a request.

    Args:
        request: whose body is received.
        most: bytes that it may have.
        what: names it in errors.
        receiving: timeouts of the bodies that are being received. Where there is one too many, the
            first is given up: it had the most time, and must not keep others out.

    Raises:
        CadenzaError: the body is larger, or does not arrive.
    """
    too_large = CadenzaError(f"{what} is larger than {most / 2**20:.3g} MiB")
    length = request.headers.get("content-length", "0")
    if not re.fullmatch("[0-9]{1,15}", length) or int(length) > most:  # Python reads no longer ones
        raise too_large
    content, receiving = bytearray(), [] if receiving is None else receiving
    try:
        async with asyncio.timeout(RECEIVE_TIME) as patience:
            receiving.append(patience)
            if len(receiving) > _MAX_RECEIVING and not (first := receiving.pop(0)).expired():
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
