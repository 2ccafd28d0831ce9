"""WebSockets on which a page is told things, and says nothing."""

from __future__ import annotations

from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol


class Telling(WebSocketsSansIOProtocol):
    """Leaves unread what comes, whatever it is; Uvicorn has a traceback for text that is none."""

    def send_receive_event_to_app(self) -> None:
        """A message has come."""
        self.frames = []
