"""Access control: only a page of the studio itself, opened with its token, reaches the server."""

import ipaddress
import secrets
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

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


class AccessControl:
    """An app behind the token: it sees requests whose path begins with it, without it.

    The Host must be this machine's name in the address bar and no domain that somebody else has
    pointed here; whatever changes something, and every WebSocket, must come from our own page.
    """

    def __init__(self, app: ASGIApp, token: str, host: str) -> None:
        self._app, self._token, self._host = app, token, host.lower()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
        elif reason := self._reason_to_refuse(scope):
            await _refuse(reason, scope, receive, send)
        else:

            async def with_headers(message: Message) -> None:
                if message["type"] == "http.response.start":
                    headers = MutableHeaders(scope=message)
                    for name, value in _HEADERS.items():
                        headers.setdefault(name, value)
                await send(message)

            inner = {**scope, "root_path": f"{scope.get('root_path', '')}/{self._token}"}
            await self._app(inner, receive, with_headers)

    def _reason_to_refuse(self, scope: Scope) -> str:
        """Return an empty string for a request that is let through."""
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
        """Return whether nobody can point this host elsewhere, as with a number or localhost."""
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
