"""Broadcasts of performances to pages."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Any

from cadenza.studio.messages import JSON, ROWS

_OVER = ("kept", "failed", "cancelled")
_LASTING = "verdict", "remarks"  # fields of a status that the ones after it have as well
_MAX_SENT = 1 << 18  # bytes of rows at once


@dataclass(eq=False)
class Broadcast:
    """A performance up to now, sent to each page from its beginning on.

    Attributes:
        title: the title of the song.
        request: see `cadenza.studio.request.PlayRequest`.
        status: `state` is queued, with the number of songs `before` it, and about how many
            `seconds` it waits, if that is known, preparing, playing, played, writing, or one of
            `_OVER`.
        texts: messages of JSON so far, see `cadenza.studio.state_stream`.
        rows: the states of all steps so far; they will be `size` bytes, 0 before that is known.
        changed: is set whenever there is more to send, and replaced.
    """

    title: str
    request: dict[str, Any]
    status: dict[str, Any] = field(default_factory=lambda: {"state": "queued"})
    texts: list[bytes] = field(default_factory=list)
    rows: bytearray | bytes = field(default_factory=bytearray)
    size: int = 0
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""
        return self.status["state"] in _OVER

    def notify(self) -> None:
        """Wake all pages that wait for news."""
        event, self.changed = self.changed, asyncio.Event()
        event.set()

    def receive(self, kind: bytes, content: bytes) -> None:
        """Add a message of the process that plays."""
        if kind == ROWS:
            assert isinstance(self.rows, bytearray)
            self.rows += content
            if self.status["state"] == "preparing":
                self.status = {"state": "playing"}
        elif kind == JSON:
            received = json.loads(content)
            if "state" not in received:
                self.texts.append(content)
                self.size = received.get("steps", 0) * received.get("row", 0) or self.size
            elif received["state"] != "preparing" or self.status["state"] != "playing":
                kept_status = {name: self.status[name] for name in _LASTING if name in self.status}
                self.status = kept_status | received
        self.notify()

    async def send_all(
        self,
        send_text: Callable[[str], Awaitable[None]],
        send_bytes: Callable[[bytes], Awaitable[None]],
    ) -> None:
        """Send JSON and rows at the pace of the page, until the performance is over."""
        await send_text(json.dumps({"title": self.title, "request": self.request}))
        status, texts, rows = None, 0, 0
        while True:
            changed = self.changed
            if status != self.status:
                status = self.status
                await send_text(json.dumps(status))
            while texts < len(self.texts):
                texts += 1
                await send_text(self.texts[texts - 1].decode())
            while rows < len(self.rows):
                part = bytes(self.rows[rows : rows + _MAX_SENT])
                await send_bytes(part)
                rows += len(part)
            if self.is_over and status == self.status:
                return
            await changed.wait()
