"""Access control: only a page of the studio itself, opened with its token, reaches the server."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
from typing import cast
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

MAX_PENDING = 64  # connections
_READING = ("GET", "HEAD")  # methods that change nothing
_POLICY_VIOLATION = 1008  # why a WebSocket is closed
_HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
        "img-src 'self' data: blob:; media-src 'self' blob:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cache-control": "no-store",
}
Address = tuple[str, int]


class PendingConnections:
    """Connections that have not shown the token; beyond `MAX_PENDING` the oldest is closed.

    So many connections that say nothing cannot keep the page out.
    """

    def __init__(self) -> None:
        self._transports: dict[Address, asyncio.Transport] = {}  # the oldest first

    def add(self, address: Address, transport: asyncio.Transport) -> None:
        """Adds a new connection."""
        self._transports[address] = transport
        if len(self._transports) > MAX_PENDING:
            self._transports.pop(next(iter(self._transports))).abort()

    def remove(self, address: Address | None) -> None:
        """Removes a connection that has ended, or has shown the token."""
        if address is not None:
            self._transports.pop(address, None)

    def protocol(self) -> type[H11Protocol]:
        """Returns the protocol of a server whose connections are pending at first."""
        pending = self

        class Protocol(H11Protocol):
            def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
                super().connection_made(transport)
                self._address = cast(Address, transport.get_extra_info("peername")[:2])
                pending.add(self._address, transport)

            def connection_lost(self, exc: Exception | None) -> None:
                pending.remove(self._address)
                super().connection_lost(exc)

        return Protocol


class AccessControl:
    """Lets requests through whose path begins with the token; the app sees the path without it.

    The Host must be this machine's name in the address bar and no domain that somebody else has
    pointed here; whatever changes something, and every WebSocket, must come from our own page.

    Attributes:
        pending: connections of which no request has been let through yet.
    """

    def __init__(self, app: ASGIApp, token: str, host: str) -> None:
        self._app, self._token, self._host = app, token, host.lower()
        self.pending = PendingConnections()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif reason := self._reason_to_refuse(scope):
            await _refuse(reason, scope, receive, send)
        else:
            self.pending.remove(scope.get("client"))

            async def with_headers(message: Message) -> None:
                if message["type"] == "http.response.start":
                    headers = MutableHeaders(scope=message)
                    for name, value in _HEADERS.items():
                        headers.setdefault(name, value)
                await send(message)

            inner = {**scope, "root_path": f"{scope.get('root_path', '')}/{self._token}"}
            await self._app(inner, receive, with_headers)

    def _reason_to_refuse(self, scope: Scope) -> str:
        """Returns an empty string for a request that is let through."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._is_ours(host):
            return "refused: this is no address of the studio"
        changes = scope["type"] == "websocket" or scope["method"] not in _READING
        if (origin is None and changes) or (origin is not None and origin != f"http://{host}"):
            return "refused: this request comes from another page"
        token = scope["path"].split("/", 2)[1] if scope["path"].startswith("/") else ""
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return "refused: open the address that `cadenza studio` has printed"
        return ""

    def _is_ours(self, host: str) -> bool:
        """Returns whether nobody can point this host elsewhere, as with a number or localhost."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in ("localhost", self._host):
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


async def _refuse(reason: str, scope: Scope, receive: Receive, send: Send) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": _POLICY_VIOLATION, "reason": reason})
    else:
        response = PlainTextResponse(f"{reason}\n", 403, _HEADERS | {"connection": "close"})
        await response(scope, receive, send)
