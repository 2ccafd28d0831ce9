"""Practice in the background: one song is practised while nothing is played."""

import asyncio
import json
from asyncio.subprocess import Process
from dataclasses import asdict
from typing import Any

from cadenza.studio.messages import JSON
from cadenza.studio.processes import kill, messages, send_order, start_bound_process, suspend
from cadenza.studio.request import Order


class BackgroundPractice:
    """Practice of a song in a process, which is suspended while others play.

    Attributes:
        order: what is practised, or was last.
        status: how far it has got; `state` is idle, or what `cadenza.studio.practice_process` says.
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
        about = {} if order is None else {"title": order.title, "request": asdict(order.request)}
        return about | {"status": self.status, "paused": self._paused}

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
        """Return whether this is practised, and no other order has taken its place."""
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
        """Say what went wrong, unless practice of this is done or was stopped."""
        if self._practises(order):
            self.status = {"state": "failed", "error": error}
