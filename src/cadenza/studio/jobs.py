"""Performances that are being made: each by a process of its own, one after the other."""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import shutil
import sys
from asyncio.subprocess import PIPE, Process
from collections import deque
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.studio.limits import READING_SECONDS
from cadenza.studio.messages import HEADER, JSON, MOST_BYTES, ROWS, TONE
from cadenza.studio.request import Order, PlayRequest, performance_folder

MOST_WAITING = 8
_MOST_WRITING = 2  # that write their files while others play
_FINISHED_KEPT = 4  # whose rows stay in memory, to be watched again
_OVER = ("kept", "failed", "cancelled")


@dataclass
class Job:
    """One performance, from the request to its files.

    Attributes:
        status: what is going on; `state` is queued, preparing, playing, played, writing, or one
            of `_OVER`.
        about: what is to be played, once that is known; see `cadenza.studio.live`.
        rows: those of all steps so far.
        tones: those that were needed so far.
        known: all tones that any job needed, by pitch and band: they sound the same.
        changed: is set whenever there is more to tell, and replaced.
        is_busy: whether a process works on it; `process` once that has started.
    """

    order: Order
    status: dict[str, Any] = field(default_factory=lambda: {"state": "queued"})
    about: bytes | None = None
    rows: bytearray = field(default_factory=bytearray)
    tones: list[bytes] = field(default_factory=list)
    changed: asyncio.Event = field(default_factory=asyncio.Event)
    known: dict[bytes, bytes] = field(default_factory=dict)
    is_busy: bool = False
    process: Process | None = None

    @property
    def id(self) -> str:
        """Also of the performance."""
        return self.order.id

    @property
    def is_over(self) -> bool:
        """Whether nothing more happens."""
        return self.status["state"] in _OVER

    @property
    def summary(self) -> dict[str, Any]:
        """As the list of jobs shows it."""
        return {"id": self.id, "title": self.order.title, "request": asdict(self.order.request)} | {
            "status": self.status
        }

    def tell(self) -> None:
        """Wakes those who watch."""
        event, self.changed = self.changed, asyncio.Event()
        event.set()

    def hear(self, kind: bytes, content: bytes) -> None:
        """Takes in a message of the process."""
        if kind == ROWS:
            self.rows += content
            if self.status["state"] == "preparing":
                self.status = {"state": "playing"}
        elif kind == TONE:
            self.tones.append(self.known.setdefault(content[:2], TONE + content))
        elif kind == JSON:
            said = json.loads(content)
            if "state" not in said:
                self.about = content
            elif said["state"] != "preparing" or self.status["state"] != "playing":
                kept = {k: self.status[k] for k in ("metrics", "spent") if k in self.status}
                self.status = kept | said
        self.tell()


class Jobs:
    """The queue. `at_once` play at the same time."""

    def __init__(self, folder: Path, at_once: int = 1, video: bool = True) -> None:
        self._folder, self._at_once, self._video = folder, at_once, video
        self.jobs: dict[str, Job] = {}
        self._tones: dict[bytes, bytes] = {}
        self._waiting: deque[Job] = deque()
        self._spare: Process | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False

    async def warm(self) -> None:
        """Has a process ready, so that the first song begins soon."""
        if self._spare is None and not self._closed:
            self._spare = await _started("cadenza.studio.worker")

    def submit(self, request: PlayRequest, title: str, source: str, uploaded: bool) -> Job:
        """Raises: CadenzaError: too many wait already."""
        if len(self._waiting) >= MOST_WAITING:
            raise CadenzaError(f"{MOST_WAITING} songs wait already; cancel one, or wait")
        id, folder = secrets.token_hex(8), str(self._folder)
        order = Order(request, title, source, uploaded, id, folder, self._video)
        job = Job(order, known=self._tones)
        self.jobs[job.id] = job
        self._waiting.append(job)
        self._pump()
        return job

    def cancel(self, id: str) -> None:
        """Ends a job at once; what it wrote goes. One that is over stays what it is."""
        job = self.jobs.get(id)
        if job is None or job.is_over:
            return
        job.status = {"state": "cancelled"}
        if job in self._waiting:
            self._waiting.remove(job)
        if job.process is not None:
            _kill(job.process)
        job.tell()
        self._pump()

    async def close(self) -> None:
        """Ends all."""
        self._closed = True
        for job in list(self.jobs.values()):
            self.cancel(job.id)
        if self._spare is not None:
            _kill(self._spare)
            await self._spare.wait()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _pump(self) -> None:
        """Starts what can be started."""
        while self._waiting and not self._closed:
            busy = [job for job in self.jobs.values() if job.is_busy]
            writing = [job for job in busy if job.status["state"] in ("played", "writing")]
            if len(busy) - len(writing) >= self._at_once or len(writing) > _MOST_WRITING:
                return
            job = self._waiting.popleft()
            job.status, job.is_busy = {"state": "preparing"}, True
            spare, self._spare = self._spare, None
            task = asyncio.create_task(self._run(job, spare))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
        over = [job for job in self.jobs.values() if job.is_over and not job.is_busy]
        for job in over[:-_FINISHED_KEPT]:
            del self.jobs[job.id]

    async def _run(self, job: Job, process: Process | None) -> None:
        try:
            if process is None or process.returncode is not None:
                process = await _started("cadenza.studio.worker")
            job.process = process
            if job.is_over:  # cancelled in between
                _kill(process)
            await self._listen(job, process)
        finally:
            job.process, job.is_busy = None, False
            self._pump()
            await self.warm()

    async def _listen(self, job: Job, process: Process) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        with suppress(ConnectionError):
            process.stdin.write(json.dumps(asdict(job.order)).encode() + b"\n")
            await process.stdin.drain()
        job.tell()
        async for kind, content in messages(process.stdout):
            was = job.status["state"]
            if was != "cancelled":
                job.hear(kind, content)
            if job.status["state"] != was:
                self._pump()
        _kill(process)
        await process.wait()
        if not job.is_over:
            job.status = {"state": "failed", "error": "the player ended unexpectedly"}
        if job.status["state"] != "kept":
            shutil.rmtree(performance_folder(self._folder, job.id), ignore_errors=True)
        job.tell()


async def messages(stream: asyncio.StreamReader) -> AsyncIterator[tuple[bytes, bytes]]:
    """Kind and content of each, until there are no more; see `cadenza.studio.messages`."""
    with suppress(asyncio.IncompleteReadError):
        while True:
            kind, length = HEADER.unpack(await stream.readexactly(HEADER.size))
            if length > MOST_BYTES:
                return
            yield kind, await stream.readexactly(length)


async def _started(module: str, *arguments: str) -> Process:
    """A process of ours, which imports nothing from the working folder."""
    command = [sys.executable, "-P", "-m", module, *arguments]
    return await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE)


def _kill(process: Process) -> None:
    with suppress(ProcessLookupError):
        process.kill()


async def read_upload(path: Path) -> dict[str, Any]:
    """What a file holds, found out by a process with limits.

    Raises:
        CadenzaError: it is no music, or more than the studio takes.
    """
    process = await _started("cadenza.studio.reading", os.fspath(path))
    try:
        out, _ = await asyncio.wait_for(process.communicate(), READING_SECONDS)
        answer = json.loads(out)
    except TimeoutError:
        answer = {"error": "it takes too long to read"}
    except ValueError:  # killed by a limit
        answer = {"error": "the file is damaged, or needs too much memory or time"}
    finally:
        _kill(process)
        await process.wait()
    if "error" in answer:
        raise CadenzaError(answer["error"])
    return answer
