"""Job queue: performances that are made one after the other, each by a process of its own."""

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
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.messages import IDLE, PAUSE, RESUME
from cadenza.studio.practice import BackgroundPractice
from cadenza.studio.processes import kill, messages, send_line, send_order, start_process
from cadenza.studio.request import PRACTISED, Order, PlayRequest, unfinished_folder
from cadenza.studio.training_runs import TrainingRuns

MAX_QUEUED = 8
_WRITING = ("played", "writing")  # states
_PLAYING = ("preparing", "playing")
_MAX_WRITING = 2  # jobs that write their files while others play
_MAX_HELD = 2  # jobs that pause in the middle of a song, with the memory that they take
RETURN_TIME = 3.0  # [s] within which a page that has gone may be back; it loads again sooner
_MAX_FAILED = 8  # jobs of which it is known that they failed or were cancelled
_CANCEL_TIME = 2.0  # [s] that a process has to drop a song that is cancelled


@dataclass(eq=False)
class Job(Broadcast):
    """A performance, from the request to its files.

    Attributes:
        order: what is played.
        is_busy: whether a process works on it; `process` once that has started.
        timeout: kills the process, where it does not drop a cancelled song in time.
        held_status: the status of the process while the job is held, since others play that are
            watched.
        num_watchers: pages that watch it.
        unwatched_since: when the last page left, or it was asked for [s], on the clock of the loop.
    """

    order: Order = field(kw_only=True)
    is_busy: bool = False
    process: Process | None = None
    timeout: asyncio.TimerHandle | None = None
    held_status: dict[str, Any] | None = None
    num_watchers: int = 0
    unwatched_since: float = field(default_factory=lambda: asyncio.get_running_loop().time())

    @property
    def id(self) -> str:
        """The name of the job, and of the performance."""
        return self.order.id

    @property
    def is_unwatched(self) -> bool:
        """Returns whether nobody watches it any more."""
        absence = asyncio.get_running_loop().time() - self.unwatched_since
        return not self.num_watchers and absence >= RETURN_TIME

    @property
    def is_held(self) -> bool:
        """Returns whether it pauses in the middle of its song."""
        return self.held_status is not None

    def receive(self, kind: bytes, content: bytes) -> None:
        """Takes in a message; a process that is held may have sent some before it paused."""
        if self.held_status is None:
            super().receive(kind, content)
            return
        queued, self.status = self.status, self.held_status
        super().receive(kind, content)
        if self.status["state"] in _PLAYING:
            self.status, self.held_status = queued, self.status
        else:  # the music was at its end
            self.held_status = None

    @property
    def summary(self) -> dict[str, Any]:
        """Fields that the page shows."""
        return {"id": self.id, "title": self.title, "status": self.status}


class JobQueue:
    """Plays `at_once` jobs at the same time; while any plays, nobody practises or learns.

    Jobs that are watched go first: a song that nobody watches any more is held for one that is.

    Attributes:
        jobs: by id; those that wait or play, and the last that failed or were cancelled.
        practice: practises songs in the background.
        trainings: trains policies in the background.
    """

    def __init__(
        self, folder: Path, trainings: TrainingRuns, at_once: int = 1, video: bool = False
    ) -> None:
        self._folder, self._at_once, self._video = folder, at_once, video
        self.jobs: dict[str, Job] = {}
        self.practice, self.trainings = BackgroundPractice(), trainings
        self._waiting: deque[Job] = deque()
        self._idle_player: Process | None = None
        self._tasks: set[asyncio.Task[None]] = set()
        self._starting, self._closed = asyncio.Lock(), False

    async def start_player(self) -> None:
        """Starts a player, so that the next song begins soon."""
        async with self._starting:  # two would each start one, and lose one
            if self._idle_player is None and not self._closed:
                with suppress(OSError):  # there is no room for it now; a song starts its own
                    self._idle_player = await start_process("cadenza.studio.player")

    def submit(
        self, request: PlayRequest, title: str, source: str, uploaded: bool, agent: str
    ) -> Job:
        """Adds a job to the queue.

        Raises:
            CadenzaError: too many wait already.
        """
        if len(self._waiting) >= MAX_QUEUED:
            raise CadenzaError(f"{MAX_QUEUED} songs wait already; cancel one, or wait")
        id, folder = secrets.token_hex(8), str(self._folder)
        order = Order(request, title, source, uploaded, id, folder, self._video, agent)
        job = self.jobs[id] = Job(title, asdict(request), order=order)
        self._waiting.append(job)
        self._schedule_now_and_later()
        return job

    @contextmanager
    def watching(self, job: Job) -> Iterator[None]:
        """Counts a page among those that watch a job, until the block ends."""
        job.num_watchers += 1
        self._schedule()
        try:
            yield
        finally:
            job.num_watchers -= 1
            job.unwatched_since = asyncio.get_running_loop().time()
            self._schedule_now_and_later()

    def cancel(self, id: str) -> None:
        """Ends a job at once, and deletes what it wrote; a job that is over stays as it is."""
        job = self.jobs.get(id)
        if job is None or job.is_over:
            return
        patience = 0.0 if job.status["state"] in _WRITING else _CANCEL_TIME
        job.status, job.held_status = {"state": "cancelled"}, None
        if job in self._waiting:
            self._waiting.remove(job)
        if job.process is not None:
            send_line(job.process, b"\n")
            job.timeout = asyncio.get_running_loop().call_later(patience, kill, job.process)
        job.notify()
        self._schedule()

    async def close(self) -> None:
        """Ends all jobs, practice and training."""
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
        await self.trainings.close()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def _schedule_now_and_later(self) -> None:
        """Schedules also when pages that have just left are not expected back."""
        self._schedule()
        asyncio.get_running_loop().call_later(RETURN_TIME, self._schedule)

    def _schedule(self) -> None:
        """Starts the jobs that can play now, and tells the others their places in the queue."""
        while (job := self._next()) is not None:
            self._start_or_resume(job)
        busy = sum(job.is_busy and not job.is_held for job in self.jobs.values())
        for before, job in enumerate(self._queue, start=busy):
            job.status = {"state": "queued", "before": before}
            job.notify()
        self._forget()
        self.practice.pause(busy > 0)
        self.trainings.pause(busy > 0)

    @property
    def _queue(self) -> list[Job]:
        """Jobs that wait to begin or to resume, those that are watched first."""
        held = (job for job in self.jobs.values() if job.is_held)
        return sorted((*held, *self._waiting), key=lambda job: job.is_unwatched)

    def _next(self) -> Job | None:
        """Returns a job that can play now, for which one that nobody watches may be held."""
        if self._closed or not (queue := self._queue):
            return None
        busy = [job for job in self.jobs.values() if job.is_busy and not job.is_held]
        playing = [job for job in busy if job.status["state"] not in _WRITING]
        if len(playing) < self._at_once and len(busy) - len(playing) <= _MAX_WRITING:
            return queue[0]
        unwatched = [job for job in playing if job.is_unwatched and job.process is not None]
        held = sum(job.is_held for job in queue)
        if not unwatched or queue[0].is_unwatched or held >= _MAX_HELD:
            return None
        self._hold(unwatched[0])
        return queue[0]

    def _hold(self, job: Job) -> None:
        assert job.process is not None
        send_line(job.process, PAUSE)
        job.held_status = job.status

    def _start_or_resume(self, job: Job) -> None:
        if job.held_status is None:
            self._waiting.remove(job)
            self._start(job)
        elif job.process is not None:
            job.status, job.held_status = job.held_status, None
            send_line(job.process, RESUME)
            job.notify()

    def _start(self, job: Job) -> None:
        job.status, job.is_busy = {"state": "preparing"}, True
        player, self._idle_player = self._idle_player, None
        task = asyncio.create_task(self._run(job, player))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _forget(self) -> None:
        """Drops what is kept, to be read from its folder, and all but the state of what failed."""
        over = [job for job in self.jobs.values() if job.is_over and not job.is_busy]
        failed = [job for job in over if job.status["state"] != "kept"]
        for job in failed:
            job.texts, job.rows = [], b""
        for job in over:
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
            job.process, job.is_busy, job.held_status = None, False, None
            if not job.is_over:
                job.status = {"state": "failed", "error": "the player ended unexpectedly"}
            if job.status["state"] != "kept":  # it may be whole, if it was cancelled just then
                for folder in unfinished_folder(self._folder, job.id), self._folder / job.id:
                    shutil.rmtree(folder, ignore_errors=True)
            job.notify()
            self._schedule()
            await self.start_player()

    async def _play(self, job: Job, process: Process) -> bool:
        """Follows a process until it ends or drops the song; returns whether it is idle then."""
        assert process.stdout is not None
        await send_order(process, job.order)
        self._schedule()  # it may be held from now on
        async for kind, content in messages(process.stdout):
            if kind == IDLE:
                return True
            state = job.status["state"]
            if state != "cancelled":
                job.receive(kind, content)
            if job.status["state"] != state:
                await self._state_changed(job)
        return False

    async def _reuse_or_kill(self, process: Process, is_idle: bool) -> None:
        """Keeps an idle process for the next song, unless another is ready already."""
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
