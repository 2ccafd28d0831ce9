"""The practice room: one song that is practised while nothing is played."""

from __future__ import annotations

import asyncio
import json
from asyncio.subprocess import Process
from dataclasses import asdict
from typing import Any

from cadenza.studio.messages import JSON
from cadenza.studio.processes import bound, hold, kill, messages, tell
from cadenza.studio.request import Order


class PracticeRoom:
    """A process practises; it stands still while others play.

    Attributes:
        order: what is practised, or was last.
        status: how far it has got; `state` is idle, or what `cadenza.studio.practising` says.
    """

    def __init__(self) -> None:
        self.order: Order | None = None
        self.status: dict[str, Any] = {"state": "idle"}
        self._process: Process | None = None
        self._task: asyncio.Task[None] | None = None
        self._paused = False

    @property
    def summary(self) -> dict[str, Any]:
        """As the page shows it."""
        order = self.order
        about = {} if order is None else {"title": order.title, "request": asdict(order.request)}
        return about | {"status": self.status, "paused": self._paused}

    def begin(self, order: Order) -> None:
        """Practises that from now on, instead of anything else."""
        if self._goes_on and self.order is not None and self.order.request == order.request:
            return
        self.stop()
        self.order, self.status = order, {"state": "preparing"}
        self._task = asyncio.create_task(self._run(order, self._task))

    def stop(self) -> None:
        """Leaves practice as it was last kept."""
        if self._process is not None:
            kill(self._process)
        if self._goes_on:
            self.status = self.status | {"state": "stopped"}

    @property
    def _goes_on(self) -> bool:
        return self.status["state"] in ("preparing", "practising")

    def pause(self, paused: bool) -> None:
        """Stands still, or goes on."""
        if paused != self._paused:
            self._paused = paused
            self._hold()

    async def close(self) -> None:
        """Ends it."""
        self.stop()
        if self._task is not None:
            await asyncio.wait({self._task})

    def _hold(self) -> None:
        if self._process is not None:
            hold(self._process, self._paused)

    async def _run(self, order: Order, before: asyncio.Task[None] | None) -> None:
        if before is not None:
            await asyncio.wait({before})
        if self.order is not order or not self._goes_on:
            return
        try:
            process = self._process = await bound("cadenza.studio.practising")
        except OSError as error:
            if self.order is order and self._goes_on:
                self.status = {"state": "failed", "error": f"practice could not begin: {error}"}
            return
        await tell(process, order)
        if self.order is not order or not self._goes_on:  # in between
            kill(process)
        self._hold()
        assert process.stdout is not None
        async for kind, content in messages(process.stdout):
            if kind == JSON and self.order is order and self._goes_on:
                self.status = json.loads(content)
        kill(process)
        await process.wait()
        self._process = None
        if self.order is order and self._goes_on:
            self.status = {"state": "failed", "error": "practice ended unexpectedly"}
