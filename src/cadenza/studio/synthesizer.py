"""The sound of a key as the page plays it: samples that Web Audio starts and damps.

As a process of its own, `python -m cadenza.studio.synthesizer`, it reads pitch and band, two bytes,
and answers with the size of the samples and the samples, again and again. The server must not make
them itself: it starts processes, and what multiplies matrices on threads may then hang for ever.
"""

from __future__ import annotations

import asyncio
import os
import signal
import struct
import sys
from asyncio import IncompleteReadError
from asyncio.subprocess import Process
from typing import Any

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.report.tone import DAMPING, LAST_DAMPER, LOUDER, tone
from cadenza.studio.processes import kill, start_process

_RATE = 32_000  # [Hz]
_SECONDS = {60: 5.0, 84: 3.5, 128: 2.0}  # [s] that tones last below a pitch: high ones die sooner
_FADE = 0.5  # [s] at the end of a tone
_NUM_PITCHES, _NUM_VELOCITIES = 128, 128  # of MIDI
_BAND = 32  # velocities that share a tone
_NUM_BANDS = _NUM_VELOCITIES // _BAND
_LOUDEST = np.iinfo(np.int16).max
_SIZE = struct.Struct("<I")
INSTRUMENT: dict[str, Any] = {
    "rate": _RATE,
    "band": _BAND,
    "damping": DAMPING,
    "last_damper": LAST_DAMPER,
    "louder": LOUDER,
}
"""Settings with which the page plays the samples."""


class Synthesizer:
    """Makes one tone after the other, by a process."""

    def __init__(self) -> None:
        self._process: Process | None = None
        self._free = asyncio.Lock()

    async def start(self) -> None:
        """Starts the process, unless it runs."""
        if self._process is None:
            self._process = await start_process("cadenza.studio.synthesizer")

    async def tone(self, pitch: int, band: int) -> bytes:
        """Returns the samples of a tone, see `samples`.

        Raises:
            CadenzaError: there is no such tone, or the process has ended.
        """
        if pitch not in range(_NUM_PITCHES) or band not in range(_NUM_BANDS):
            raise CadenzaError("there is no such tone")
        async with self._free:
            await self.start()
            process = self._process
            assert process is not None
            try:
                return await _answer(process, bytes((pitch, band)))
            except BaseException as error:
                kill(process)  # it might answer this to whoever asks next
                self._process = None
                if isinstance(error, (IncompleteReadError, ConnectionError)):
                    raise CadenzaError("the tone cannot be made") from error
                raise

    async def close(self) -> None:
        """Ends the process."""
        if self._process is not None:
            kill(self._process)
            await self._process.wait()


async def _answer(process: Process, question: bytes) -> bytes:
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.write(question)
    await process.stdin.drain()
    (size,) = _SIZE.unpack(await process.stdout.readexactly(_SIZE.size))
    return await process.stdout.readexactly(size)


def samples(pitch: int, band: int) -> bytes:
    """Returns the peak as float32, and int16 samples, little-endian, faded out at their end.

    Args:
        pitch: as MIDI counts.
        band: of velocities, below `_NUM_BANDS`.
    """
    seconds = next(seconds for above, seconds in _SECONDS.items() if pitch < above)
    middle = (band + 0.5) * _BAND  # velocity
    sound = tone(pitch, middle / (_NUM_VELOCITIES - 1), seconds, _RATE)
    fade = int(_FADE * _RATE)
    sound[-fade:] *= np.linspace(1, 0, fade, dtype=np.float32)
    peak = float(np.abs(sound).max())
    return struct.pack("<f", peak) + np.rint(sound / peak * _LOUDEST).astype("<i2").tobytes()


def main() -> None:
    """Answers questions on stdin until there are no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which kills this
    with os.fdopen(os.dup(1), "wb") as out:
        while question := sys.stdin.buffer.read(2):
            made = samples(*question)
            out.write(_SIZE.pack(len(made)) + made)
            out.flush()


if __name__ == "__main__":
    main()
