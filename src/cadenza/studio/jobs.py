"""The queue of performances, and practice between them, each in a process of its own."""

import asyncio
import json
import math
import secrets
import shutil
import time
from asyncio.subprocess import Process
from collections import deque
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.messages import IDLE, JSON
from cadenza.studio.processes import (
    cancel_song,
    kill,
    messages,
    send_order,
    start_bound_process,
    start_process,
    suspend,
)
from cadenza.studio.request import PRACTISED, Order, PlayRequest, unfinished_folder

MAX_QUEUED = 8
_WRITING = ("played", "writing")  # states
_MAX_WRITING = 2  # jobs that write their files while others play
_MAX_FAILED = 8  # jobs that are remembered as failed or cancelled
_TELLING_UNIT = 5  # [s] to which those that wait are told how long, and after which that is known
_CANCEL_TIME = 2.0  # [s] that a process has to drop a song that is cancelled


@dataclass(eq=False)
class Job(Broadcast):
    """A performance, from the request to its files.

    Attributes:
        order: the order to the process that plays.
        is_busy: whether a process works on it; `process` once that has started, which plans steps
            from the time `begun` [s] on.
        timeout: kills the process, where it does not drop a cancelled song in time.
    """

    order: Order = field(kw_only=True)
    is_busy: bool = False
    begun: float = 0.0
    process: Process | None = None
    timeout: asyncio.TimerHandle | None = None

    @property
    def id(self) -> str:
        """The name of the job, and of the performance."""
        return self.order.id

    @property
    def summary(self) -> dict[str, Any]:
        """Fields that the page shows."""
        return {"id": self.id, "title": self.title, "status": self.status}

    @property
    def time_left(self) -> float:
        """About how long it will still be planned [s], infinite before that is known."""
        passed = time.monotonic() - self.begun
        if not self.begun or not self.size or passed < _TELLING_UNIT:
            return math.inf
        return passed * (self.size / len(self.rows) - 1)


class JobQueue:
    """A queue that plays `at_once` jobs at a time, in order, and suspends practice meanwhile.

    Attributes:
        jobs: by id; jobs that wait or play, and the last ones that failed or were cancelled.
        practice: practice in the background.
    """

    def __init__(self, folder: Path, at_once: int = 1) -> None:
        self._folder, self._at_once = folder, at_once
        self.jobs: dict[str, Job] = {}
        self.practice = BackgroundPractice()
        self._waiting: deque[Job] = deque()
        self._idle_player: Process | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._starting, self._closed = asyncio.Lock(), False

    async def start_player(self) -> None:
        """Start a player, so that the next song begins soon."""
        async with self._starting:  # two would each start one, and lose one
            if self._idle_player is None and not self._closed:
                with suppress(OSError):  # there is no room for it now; a song starts its own
                    self._idle_player = await start_process("cadenza.studio.player")

    def submit(self, request: PlayRequest, title: str, source: str, uploaded: bool) -> Job:
        """Add a job to the queue. Raises CadenzaError if too many wait already."""
        if len(self._waiting) >= MAX_QUEUED:
            raise CadenzaError(f"{MAX_QUEUED} songs wait already; cancel one, or wait")
        id, folder = secrets.token_hex(8), str(self._folder)
        order = Order(request, title, source, uploaded, id, folder)
        job = self.jobs[id] = Job(title, asdict(request), order=order)
        self._waiting.append(job)
        self._schedule()
        return job

    def cancel(self, id: str) -> None:
        """End a job at once, and delete what it wrote; a job that is over stays as it is."""
        job = self.jobs.get(id)
        if job is None or job.is_over:
            return
        patience = 0.0 if job.status["state"] in _WRITING else _CANCEL_TIME
        job.status = {"state": "cancelled"}
        if job in self._waiting:
            self._waiting.remove(job)
        if job.process is not None:
            cancel_song(job.process)
            job.timeout = asyncio.get_running_loop().call_later(patience, kill, job.process)
        job.notify()
        self._schedule()

    async def close(self) -> None:
        """End all jobs, and practice."""
        self._closed = True
        for job in list(self.jobs.values()):
            self.cancel(job.id)
            if job.process is not None:
                kill(job.process)
        async with self._starting:
            if self._idle_player is not None:
                kill(self._idle_player)
                await self._idle_player.wait()
        await self.practice.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _schedule(self) -> None:
        """Start the jobs that can play now, and update the places of the others in the queue."""
        while self._waiting and self._has_room():
            self._start(self._waiting.popleft())
        self._tell_waiting()
        self._forget()
        self.practice.pause(any(job.is_busy for job in self.jobs.values()))

    def _tell_waiting(self) -> None:
        """Tell songs their places in the queue, and the next ones about when they begin."""
        busy = [job for job in self.jobs.values() if job.is_busy]
        ends = sorted(job.time_left for job in busy if job.status["state"] not in _WRITING)
        for place, job in enumerate(self._waiting):
            status = {"state": "queued", "before": len(busy) + place}
            if place < len(ends) and math.isfinite(ends[place]):
                status["seconds"] = _TELLING_UNIT * math.ceil(ends[place] / _TELLING_UNIT)
            if status != job.status:
                job.status = status
                job.notify()

    def _has_room(self) -> bool:
        busy = [job for job in self.jobs.values() if job.is_busy]
        num_writing = sum(job.status["state"] in _WRITING for job in busy)
        has_room = len(busy) - num_writing < self._at_once and num_writing <= _MAX_WRITING
        return has_room and not self._closed

    def _start(self, job: Job) -> None:
        job.status, job.is_busy = {"state": "preparing"}, True
        player, self._idle_player = self._idle_player, None
        task = asyncio.create_task(self._run(job, player))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _forget(self) -> None:
        """Drop jobs with a folder, and all but the states of jobs that failed."""
        finished = [job for job in self.jobs.values() if job.is_over and not job.is_busy]
        failed = [job for job in finished if job.status["state"] != "kept"]
        for job in failed:
            job.texts, job.rows = [], b""
        for job in finished:
            if job not in failed[-_MAX_FAILED:]:
                del self.jobs[job.id]

    async def _run(self, job: Job, process: Process | None) -> None:
        is_idle = False
        try:
            if process is None or process.returncode is not None:
                process = await start_process("cadenza.studio.player")
            job.process = process
            is_idle = job.is_over or await self._play(job, process)  # cancelled in between
        finally:
            if job.timeout is not None:
                job.timeout.cancel()
            if process is not None:
                await self._reuse_or_kill(process, is_idle)
            job.process, job.is_busy = None, False
            if not job.is_over:
                job.status = {"state": "failed", "error": "the player ended unexpectedly"}
            if job.status["state"] != "kept":  # it may be whole, if it was cancelled just then
                for folder in unfinished_folder(self._folder, job.id), self._folder / job.id:
                    shutil.rmtree(folder, ignore_errors=True)
            job.notify()
            self._schedule()
            await self.start_player()

    async def _play(self, job: Job, process: Process) -> bool:
        """Follow a process until it ends or drops the song; return whether it is idle then."""
        assert process.stdout is not None
        await send_order(process, job.order)
        async for kind, content in messages(process.stdout):
            if kind == IDLE:
                return True
            state = job.status["state"]
            if state != "cancelled":
                job.receive(kind, content)
                job.begun = job.begun or bool(job.rows) * time.monotonic()
                self._tell_waiting()
            if job.status["state"] != state:
                await self._state_changed(job)
        return False

    async def _reuse_or_kill(self, process: Process, is_idle: bool) -> None:
        """Keep an idle process for the next song, unless another is ready already."""
        if is_idle and self._idle_player is None and not self._closed:
            self._idle_player = process
        else:
            kill(process)
            await process.wait()

    async def _state_changed(self, job: Job) -> None:
        state = job.status["state"]
        if state == "kept" and job.order.request.agent == PRACTISED:
            self.practice.begin(job.order)
        self._schedule()
        if state == "played":
            await self.start_player()


class BackgroundPractice:
    """Practice of a song in a process, which is suspended while others play.

    Attributes:
        order: the order that is practised, or was last.
        status: progress; `state` is idle, or as in `cadenza.studio.practice_process`.
    """

    def __init__(self) -> None:
        self.order: Order | None = None
        self.status: dict[str, Any] = {"state": "idle"}
        self._process: Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._paused = False

    @property
    def summary(self) -> dict[str, Any]:
        """Fields that the page shows."""
        order = self.order
        song = {} if order is None else {"title": order.title, "request": asdict(order.request)}
        return song | {"status": self.status, "paused": self._paused}

    def begin(self, order: Order) -> None:
        """Practise a song from now on, instead of any other."""
        if self._is_active and self.order is not None and self.order.request == order.request:
            return
        self.stop()
        self.order, self.status = order, {"state": "preparing"}
        self._task = asyncio.create_task(self._run(order, self._task))

    def stop(self) -> None:
        """End practice; what was saved last stays."""
        if self._process is not None:
            kill(self._process)
        if self._is_active:
            self.status = self.status | {"state": "stopped"}

    @property
    def _is_active(self) -> bool:
        return self.status["state"] in ("preparing", "practising")

    def _practises(self, order: Order) -> bool:
        return self.order is order and self._is_active

    def pause(self, paused: bool) -> None:
        """Suspend practice, or have it go on."""
        if paused != self._paused:
            self._paused = paused
            if self._process is not None:
                suspend(self._process, paused)

    async def close(self) -> None:
        """End practice, and wait for its process."""
        self.stop()
        if self._task is not None:
            await asyncio.wait({self._task})

    async def _run(self, order: Order, previous: asyncio.Task[None] | None) -> None:
        if previous is not None:
            await asyncio.wait({previous})
        if not self._practises(order):
            return
        try:
            process = self._process = await start_bound_process("cadenza.studio.practice_process")
        except OSError as error:
            self._fail(order, f"practice could not begin: {error}")
            return
        await send_order(process, order)
        if not self._practises(order):  # stopped in between
            kill(process)
        suspend(process, self._paused)
        assert process.stdout is not None
        async for kind, content in messages(process.stdout):
            if kind == JSON and self._practises(order):
                self.status = json.loads(content)
        kill(process)
        await process.wait()
        self._process = None
        self._fail(order, "practice ended unexpectedly")

    def _fail(self, order: Order, error: str) -> None:
        """Report an error, unless this practice is done or was stopped."""
        if self._practises(order):
            self.status = {"state": "failed", "error": error}
