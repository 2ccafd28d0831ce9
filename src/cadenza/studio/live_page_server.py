"""Server of one performance, as a process: `python -m cadenza.studio.live_page_server ORDER`.

Another process plays it. This one takes the order as JSON, and reads on stdin the messages that
`cadenza.studio.messages` describes.
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
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.page_server import PageServer, serve
from cadenza.studio.processes import messages
from cadenza.studio.request import Order


class LivePageServer(PageServer):
    """A server of one performance, which cannot be changed from the page."""

    def __init__(self, order: Order) -> None:
        super().__init__()
        self._id = order.id
        self._broadcast = Broadcast(order.title, asdict(order.request), {"state": "preparing"})

    async def broadcast(self, id: str) -> Broadcast | None:
        """Return the performance if this is its id."""
        return self._broadcast if id == self._id else None

    def routes(self) -> list[BaseRoute]:
        """Return all that the server answers."""
        return [*super().routes(), Route("/api/songs", self.songs)]

    async def songs(self, _: Request) -> Response:
        """Answer that there is only the one performance."""
        return JSONResponse({"songs": [], "agents": {}, "hands": {}, "only": self._id})

    @asynccontextmanager
    async def lifespan(self, app: Starlette) -> AsyncIterator[None]:
        """Receive the performance from the start of the server to its end."""
        async with super().lifespan(app):
            receiving = asyncio.create_task(self._receive())
            try:
                yield
            finally:
                receiving.cancel()
                with suppress(asyncio.CancelledError):
                    await receiving

    async def _receive(self) -> None:
        reader = asyncio.StreamReader()
        protocol = asyncio.StreamReaderProtocol(reader)
        await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
        async for kind, content in messages(reader):
            self._broadcast.receive(kind, content)
        if not self._broadcast.is_over:
            self._broadcast.status = {"state": "cancelled"}
            self._broadcast.notify()
        signal.raise_signal(signal.SIGTERM)  # the player has gone, and nobody else ends this


def main() -> None:
    """Serve until the process is told to end."""
    with suppress(KeyboardInterrupt):
        serve(LivePageServer(parsed_json(sys.argv[1], Order, "order")))


if __name__ == "__main__":
    main()
