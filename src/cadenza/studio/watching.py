"""Shows one performance that another process plays: `python -m cadenza.studio.watching ORDER`.

It takes the order as JSON, and reads on stdin what `cadenza.studio.messages` has.
"""

from __future__ import annotations

import asyncio
import signal
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from cadenza.files import parsed_json
from cadenza.studio.processes import messages
from cadenza.studio.request import Order
from cadenza.studio.stream import Stream
from cadenza.studio.watchable import Watchable, serve


class Watching(Watchable):
    """One performance, which cannot be changed from the page."""

    def __init__(self, order: Order) -> None:
        super().__init__()
        self._id = order.id
        self._stream = Stream(order.title, asdict(order.request), {"state": "preparing"})

    async def stream(self, id: str) -> Stream | None:
        """See `Watchable`."""
        return self._stream if id == self._id else None

    def routes(self) -> list[BaseRoute]:
        """See `Watchable`."""
        return [
            *super().routes(),
            Route("/api/songs", self.songs),
            Route("/api/performances", self.performances),
        ]

    async def songs(self, _: Request) -> Response:
        """None but the one."""
        return JSONResponse({"songs": [], "agents": {}, "hands": {}, "only": self._id})

    async def performances(self, _: Request) -> Response:
        """Whoever plays says where the files are."""
        return JSONResponse([])

    @asynccontextmanager
    async def lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """See `Watchable`."""
        async with super().lifespan(app):
            listening = asyncio.create_task(self._listen())
            try:
                yield
            finally:
                listening.cancel()
                with suppress(asyncio.CancelledError):
                    await listening

    async def _listen(self) -> None:
        reader = asyncio.StreamReader()
        protocol = asyncio.StreamReaderProtocol(reader)
        await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
        async for kind, content in messages(reader):
            self._stream.hear(kind, content)
        if not self._stream.is_over:
            self._stream.status = {"state": "cancelled"}
            self._stream.wake()
        signal.raise_signal(signal.SIGTERM)  # whoever plays has gone, and nobody else ends this


def main() -> None:
    """See above."""
    with suppress(KeyboardInterrupt):
        serve(Watching(parsed_json(sys.argv[1], Order, "order")))


if __name__ == "__main__":
    main()
