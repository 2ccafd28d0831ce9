"""A performance as those who watch it are told, from its beginning on, until it is over."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cadenza.studio.messages import JSON, ROWS

_OVER = ("kept", "failed", "cancelled")
_KEPT = "metrics", "spent", "remarks"  # of a status, for those after it
_MOST_SENT = 1 << 18  # bytes of rows at once


class Stored:
    """Bytes in a file, of which only those that are asked for take memory."""

    def __init__(self, path: Path) -> None:
        """Raises: OSError: it cannot be read."""
        self._path, self._size = path, path.stat().st_size

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        with self._path.open("rb") as file:
            file.seek(part.start)
            return file.read(part.stop - part.start)


@dataclass(eq=False)
class Stream:
    """What there is of it so far.

    Attributes:
        title: of the song.
        request: what was asked for, see `cadenza.studio.request.PlayRequest`.
        status: what is going on; `state` is queued, with how many come `before`, preparing,
            playing, played, writing, or one of `_OVER`.
        about: what is to be played, once that is known; see `cadenza.studio.live`.
        rows: those of all steps so far.
        changed: is set whenever there is more to tell, and replaced.
    """

    title: str
    request: dict[str, Any]
    status: dict[str, Any] = field(default_factory=lambda: {"state": "queued"})
    about: bytes | None = None
    rows: bytearray | bytes | Stored = field(default_factory=bytearray)
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def is_over(self) -> bool:
        """Whether nothing more happens."""
        return self.status["state"] in _OVER

    def wake(self) -> None:
        """Has those who watch look again."""
        event, self.changed = self.changed, asyncio.Event()
        event.set()

    def hear(self, kind: bytes, content: bytes) -> None:
        """Takes in a message of the process that plays."""
        if kind == ROWS:
            assert isinstance(self.rows, bytearray)
            self.rows += content
            if self.status["state"] == "preparing":
                self.status = {"state": "playing"}
        elif kind == JSON:
            said = json.loads(content)
            if "state" not in said:
                self.about = content
            elif said["state"] != "preparing" or self.status["state"] != "playing":
                kept = {k: self.status[k] for k in _KEPT if k in self.status}
                self.status = kept | said
        self.wake()

    async def tell(
        self,
        say: Callable[[str], Awaitable[None]],
        send: Callable[[bytes], Awaitable[None]],
    ) -> None:
        """Says all in JSON and sends the rows, no faster than they are taken, until it is over."""
        await say(json.dumps({"title": self.title, "request": self.request}))
        told, about, rows = None, False, 0
        while True:
            changed = self.changed
            if told != self.status:
                told = self.status
                await say(json.dumps(told))
            if not about and self.about is not None:
                about = True
                await say(self.about.decode())
            while rows < len(self.rows):
                part = bytes(self.rows[rows : rows + _MOST_SENT])
                await send(part)
                rows += len(part) or len(self.rows)  # of a file that was cut off meanwhile
            if self.is_over and told == self.status:
                return
            await changed.wait()
