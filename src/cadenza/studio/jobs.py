"""Performances that are being made: each by a process of its own, one after the other."""

from __future__ import annotations

import asyncio
import json
import secrets
import shutil
from asyncio.subprocess import Process
from collections import deque
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.studio.messages import JSON, ROWS, TONE
from cadenza.studio.practice import PracticeRoom
from cadenza.studio.processes import kill, messages, started, tell
from cadenza.studio.request import PRACTISED, Order, PlayRequest, performance_folder
from cadenza.studio.trainings import Trainings

MOST_WAITING = 8
_MOST_WRITING = 2  # that write their files while others play
_FINISHED_KEPT = 2  # whose rows stay in memory, to be watched again
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
    """The queue. `at_once` play at the same time; while any does, nobody practises or learns.

    Attributes:
        jobs: those that wait or play, and the last ones.
        practice: where a song goes on being practised whose player asked for that.
        trainings: where policies learn.
    """

    def __init__(
        self, folder: Path, trainings: Trainings, at_once: int = 1, video: bool = True
    ) -> None:
        self._folder, self._at_once, self._video = folder, at_once, video
        self.jobs: dict[str, Job] = {}
        self.practice, self.trainings = PracticeRoom(), trainings
        self._tones: dict[bytes, bytes] = {}
        self._waiting: deque[Job] = deque()
        self._spare: Process | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._closed = False

    async def warm(self) -> None:
        """Has a process ready, so that the first song begins soon."""
        if self._spare is None and not self._closed:
            self._spare = await started("cadenza.studio.worker")

    def submit(
        self, request: PlayRequest, title: str, source: str, uploaded: bool, agent: str
    ) -> Job:
        """Raises: CadenzaError: too many wait already."""
        if len(self._waiting) >= MOST_WAITING:
            raise CadenzaError(f"{MOST_WAITING} songs wait already; cancel one, or wait")
        id, folder = secrets.token_hex(8), str(self._folder)
        order = Order(request, title, source, uploaded, id, folder, self._video, agent)
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
            kill(job.process)
        job.tell()
        self._pump()

    async def close(self) -> None:
        """Ends all."""
        self._closed = True
        for job in list(self.jobs.values()):
            self.cancel(job.id)
        if self._spare is not None:
            kill(self._spare)
            await self._spare.wait()
        await self.practice.close()
        await self.trainings.close()
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
        playing = any(job.is_busy for job in self.jobs.values())
        self.practice.pause(playing)
        self.trainings.pause(playing)

    async def _run(self, job: Job, process: Process | None) -> None:
        try:
            if process is None or process.returncode is not None:
                process = await started("cadenza.studio.worker")
            job.process = process
            if job.is_over:  # cancelled in between
                kill(process)
            await self._listen(job, process)
        finally:
            job.process, job.is_busy = None, False
            self._pump()
            await self.warm()

    async def _listen(self, job: Job, process: Process) -> None:
        assert process.stdout is not None
        await tell(process, job.order)
        job.tell()
        async for kind, content in messages(process.stdout):
            was = job.status["state"]
            if was != "cancelled":
                job.hear(kind, content)
            if job.status["state"] != was:
                if job.status["state"] == "kept" and job.order.request.agent == PRACTISED:
                    self.practice.begin(job.order)
                self._pump()
        kill(process)
        await process.wait()
        if not job.is_over:
            job.status = {"state": "failed", "error": "the player ended unexpectedly"}
        if job.status["state"] != "kept":
            shutil.rmtree(performance_folder(self._folder, job.id), ignore_errors=True)
        job.tell()
