"""Connections that have not shown the token: too many of them must not keep the page out."""

from __future__ import annotations

import asyncio
from typing import cast

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_STRANGERS = 64
Address = tuple[str, int]


class Strangers:
    """Where there is one too many, the one that came first is sent away."""

    def __init__(self) -> None:
        self._transports: dict[Address, asyncio.Transport] = {}  # as they came

    def come(self, address: Address, transport: asyncio.Transport) -> None:
        """Somebody has connected."""
        self._transports[address] = transport
        if len(self._transports) > MOST_STRANGERS:
            self._transports.pop(next(iter(self._transports))).abort()

    def go(self, address: Address | None) -> None:
        """They have disconnected, or are no strangers any more."""
        if address is not None:
            self._transports.pop(address, None)

    def protocol(self) -> type[H11Protocol]:
        """What a server speaks that knows of them."""
        strangers = self

        class Protocol(H11Protocol):
            def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
                super().connection_made(transport)
                self._address = cast(Address, transport.get_extra_info("peername")[:2])
                strangers.come(self._address, transport)

            def connection_lost(self, exc: Exception | None) -> None:
                strangers.go(self._address)
                super().connection_lost(exc)

        return Protocol
