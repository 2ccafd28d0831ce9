"""Performances that are being made: each by a process of its own, one after the other."""

from __future__ import annotations

import asyncio
import secrets
import shutil
from asyncio.subprocess import Process
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.studio.messages import GO_ON, READY, WAIT
from cadenza.studio.practice import PracticeRoom
from cadenza.studio.processes import kill, messages, say, started, tell
from cadenza.studio.request import PRACTISED, Order, PlayRequest, performance_folder
from cadenza.studio.stream import Stream
from cadenza.studio.trainings import Trainings

MOST_WAITING = 8
_WRITING = ("played", "writing")
_PLAYING = ("preparing", "playing")
_MOST_WRITING = 2  # that write their files while others play
_MOST_HELD = 2  # that wait in the middle of a song, with the memory that they take
_ABSENT = 3.0  # [s] after which nobody who has left is expected back; a page loads again sooner
_ENDED_KNOWN = 8  # of which one can be told what became of them
_TO_PUT_DOWN = 2.0  # [s] that a process has to put down what is cancelled


@dataclass(eq=False)
class Job(Stream):
    """One performance, from the request to its files.

    Attributes:
        order: what is played.
        is_busy: whether a process works on it; `process` once that has started.
        end: of the process, where it does not put the song down in time.
        held: what its status would be, where it is held while others play who are watched.
        watchers: pages that watch it.
        alone_since: when the last of them left, or it was asked for [s], on the clock of the loop.
    """

    order: Order = field(kw_only=True)
    is_busy: bool = False
    process: Process | None = None
    end: asyncio.TimerHandle | None = None
    held: dict[str, Any] | None = None
    watchers: int = 0
    alone_since: float = field(default_factory=lambda: asyncio.get_running_loop().time())

    @classmethod
    def of(cls, order: Order) -> Job:
        """Before it has begun."""
        return cls(order.title, asdict(order.request), order=order)

    @property
    def id(self) -> str:
        """Also of the performance."""
        return self.order.id

    @property
    def is_left(self) -> bool:
        """Whether nobody watches it any more."""
        absent = asyncio.get_running_loop().time() - self.alone_since
        return not self.watchers and absent >= _ABSENT

    def hear(self, kind: bytes, content: bytes) -> None:
        """See `Stream`; a process that is held may have something to tell from before."""
        if self.held is None:
            super().hear(kind, content)
            return
        shown, self.status = self.status, self.held
        super().hear(kind, content)
        if self.status["state"] in _PLAYING:
            self.status, self.held = shown, self.status
        else:  # the music was at its end
            self.held = None

    @property
    def summary(self) -> dict[str, Any]:
        """As it is answered to whoever asks for it."""
        return {"id": self.id, "title": self.title, "status": self.status}


class Jobs:
    """The queue. `at_once` play at the same time; while any does, nobody practises or learns.

    Who is watched goes first: a song that nobody watches any more is held for one that is.

    Attributes:
        jobs: those that wait or play, and the last that came to nothing.
        practice: where a song goes on being practised whose player asked for that.
        trainings: where policies learn.
    """

    def __init__(
        self, folder: Path, trainings: Trainings, at_once: int = 1, video: bool = True
    ) -> None:
        self._folder, self._at_once, self._video = folder, at_once, video
        self.jobs: dict[str, Job] = {}
        self.practice, self.trainings = PracticeRoom(), trainings
        self._waiting: deque[Job] = deque()
        self._spare: Process | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._warming, self._closed = asyncio.Lock(), False

    async def warm(self) -> None:
        """Has a process ready, so that the first song begins soon."""
        async with self._warming:  # two would each start one, and lose one
            if self._spare is None and not self._closed:
                with suppress(OSError):  # there is no room for it now; a song starts its own
                    self._spare = await started("cadenza.studio.worker")

    def submit(
        self, request: PlayRequest, title: str, source: str, uploaded: bool, agent: str
    ) -> Job:
        """Raises: CadenzaError: too many wait already."""
        if len(self._waiting) >= MOST_WAITING:
            raise CadenzaError(f"{MOST_WAITING} songs wait already; cancel one, or wait")
        id, folder = secrets.token_hex(8), str(self._folder)
        order = Order(request, title, source, uploaded, id, folder, self._video, agent)
        job = Job.of(order)
        self.jobs[job.id] = job
        self._waiting.append(job)
        self._pump_soon()
        return job

    @contextmanager
    def watching(self, job: Job) -> Iterator[None]:
        """While a page watches it."""
        job.watchers += 1
        self._pump()
        try:
            yield
        finally:
            job.watchers -= 1
            job.alone_since = asyncio.get_running_loop().time()
            self._pump_soon()

    def _pump_soon(self) -> None:
        """Now, and when pages that have just left are not expected back."""
        self._pump()
        asyncio.get_running_loop().call_later(_ABSENT, self._pump)

    def cancel(self, id: str) -> None:
        """Ends a job at once; what it wrote goes. One that is over stays what it is."""
        job = self.jobs.get(id)
        if job is None or job.is_over:
            return
        patience = 0.0 if job.status["state"] in _WRITING else _TO_PUT_DOWN
        job.status, job.held = {"state": "cancelled"}, None
        if job in self._waiting:
            self._waiting.remove(job)
        if job.process is not None:
            say(job.process, b"\n")
            job.end = asyncio.get_running_loop().call_later(patience, kill, job.process)
        job.wake()
        self._pump()

    async def close(self) -> None:
        """Ends all."""
        self._closed = True
        for job in list(self.jobs.values()):
            self.cancel(job.id)
            if job.process is not None:
                kill(job.process)
        async with self._warming:
            if self._spare is not None:
                kill(self._spare)
                await self._spare.wait()
        await self.practice.close()
        await self.trainings.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _pump(self) -> None:
        """Starts what can be started."""
        while (job := self._next()) is not None:
            self._play(job)
        busy = sum(job.is_busy and job.held is None for job in self.jobs.values())
        for before, job in enumerate(self._in_line, start=busy):
            job.status = {"state": "queued", "before": before}
            job.wake()
        self._forget()
        self.practice.pause(busy > 0)
        self.trainings.pause(busy > 0)

    @property
    def _in_line(self) -> list[Job]:
        """Those that wait to begin or to go on, who is watched first."""
        held = (job for job in self.jobs.values() if job.held is not None)
        return sorted((*held, *self._waiting), key=lambda job: job.is_left)

    def _next(self) -> Job | None:
        """Who can play now, where need be instead of one that nobody watches, which is held."""
        if self._closed or not (line := self._in_line):
            return None
        busy = [job for job in self.jobs.values() if job.is_busy and job.held is None]
        playing = [job for job in busy if job.status["state"] not in _WRITING]
        if len(playing) < self._at_once and len(busy) - len(playing) <= _MOST_WRITING:
            return line[0]
        left = next((job for job in playing if job.is_left and job.process is not None), None)
        held = sum(job.held is not None for job in line)
        if left is None or line[0].is_left or held >= _MOST_HELD:
            return None
        assert left.process is not None
        say(left.process, WAIT)
        left.held = left.status
        return line[0]

    def _play(self, job: Job) -> None:
        """Has it begin, or go on."""
        if job.held is None:
            self._waiting.remove(job)
            self._start(job)
        elif job.process is not None:
            job.status, job.held = job.held, None
            say(job.process, GO_ON)
            job.wake()

    def _start(self, job: Job) -> None:
        job.status, job.is_busy = {"state": "preparing"}, True
        spare, self._spare = self._spare, None
        task = asyncio.create_task(self._run(job, spare))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _forget(self) -> None:
        """What is kept is told from its folder, and of what came to nothing only that it did."""
        over = [job for job in self.jobs.values() if job.is_over and not job.is_busy]
        failed = [job for job in over if job.status["state"] != "kept"]
        for job in failed:
            job.about, job.rows = None, b""
        for job in over:
            if job not in failed[-_ENDED_KNOWN:]:
                del self.jobs[job.id]

    async def _run(self, job: Job, process: Process | None) -> None:
        is_free = False
        try:
            if process is None or process.returncode is not None:
                process = await started("cadenza.studio.worker")
            job.process = process
            is_free = job.is_over or await self._listen(job, process)  # cancelled in between
        finally:
            if job.end is not None:
                job.end.cancel()
            if process is not None:
                await self._leave(process, is_free)
            job.process, job.is_busy, job.held = None, False, None
            if not job.is_over:
                job.status = {"state": "failed", "error": "the player ended unexpectedly"}
            if job.status["state"] != "kept":  # it may be whole, if it was cancelled just then
                for folder in performance_folder(self._folder, job.id), self._folder / job.id:
                    shutil.rmtree(folder, ignore_errors=True)
            job.wake()
            self._pump()
            await self.warm()

    async def _listen(self, job: Job, process: Process) -> bool:
        """Until the process ends or has put the song down: whether it has."""
        assert process.stdout is not None
        await tell(process, job.order)
        self._pump()  # it may be held from now on
        async for kind, content in messages(process.stdout):
            if kind == READY:
                return True
            was = job.status["state"]
            if was != "cancelled":
                job.hear(kind, content)
            if job.status["state"] != was:
                await self._changed(job)
        return False

    async def _leave(self, process: Process, is_free: bool) -> None:
        """Has a process that is free play the next song, unless one is ready already."""
        if is_free and self._spare is None and not self._closed:
            self._spare = process
        else:
            kill(process)
            await process.wait()

    async def _changed(self, job: Job) -> None:
        state = job.status["state"]
        if state == "kept" and job.order.request.agent == PRACTISED:
            self.practice.begin(job.order)
        self._pump()
        if state == "played":
            await self.warm()
