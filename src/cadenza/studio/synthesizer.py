"""Has tones made by a process of its own."""

from __future__ import annotations

import asyncio
from asyncio import IncompleteReadError
from asyncio.subprocess import Process

from cadenza.errors import CadenzaError
from cadenza.studio.processes import kill, started
from cadenza.studio.tones import BANDS, SIZE


class Synthesizer:
    """One tone after the other."""

    def __init__(self) -> None:
        self._process: Process | None = None
        self._free = asyncio.Lock()

    async def warm(self) -> None:
        """Has the process ready."""
        if self._process is None:
            self._process = await started("cadenza.studio.tones")

    async def tone(self, pitch: int, band: int) -> bytes:
        """See `cadenza.studio.tones.samples`.

        Raises:
            CadenzaError: there is no such tone, or the process has ended.
        """
        if pitch not in range(128) or band not in range(BANDS):
            raise CadenzaError("there is no such tone")
        async with self._free:
            await self.warm()
            process = self._process
            assert process is not None
            try:
                return await _asked(process, bytes((pitch, band)))
            except BaseException as error:
                kill(process)  # it might answer this to whoever asks next
                self._process = None
                if isinstance(error, (IncompleteReadError, ConnectionError)):
                    raise CadenzaError("the tone cannot be made") from error
                raise

    async def close(self) -> None:
        """Ends it."""
        if self._process is not None:
            kill(self._process)
            await self._process.wait()


async def _asked(process: Process, question: bytes) -> bytes:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(question)
    await process.stdin.drain()
    (size,) = SIZE.unpack(await process.stdout.readexactly(SIZE.size))
    return await process.stdout.readexactly(size)
