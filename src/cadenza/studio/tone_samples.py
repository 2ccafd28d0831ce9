"""Samples of keys, which the page plays and damps by Web Audio."""

import struct
from typing import Any

import numpy as np
from anyio import BrokenWorkerProcess, CapacityLimiter, to_process

from cadenza.errors import CadenzaError
from cadenza.report.tone import DAMPING, LAST_DAMPER, LOUDER, tone

_RATE = 32_000  # [Hz]
_SECONDS = {60: 5.0, 84: 3.5, 128: 2.0}  # [s] that tones last below a pitch: high ones die sooner
_FADE = 0.5  # [s] at the end of a tone
NUM_PITCHES, _NUM_VELOCITIES = 128, 128  # of MIDI
_BAND = 32  # velocities that share a tone
NUM_BANDS = _NUM_VELOCITIES // _BAND
_LOUDEST = np.iinfo(np.int16).max
INSTRUMENT: dict[str, Any] = {
    "rate": _RATE,
    "band": _BAND,
    "damping": DAMPING,
    "last_damper": LAST_DAMPER,
    "louder": LOUDER,
}
"""Settings with which the page plays the samples."""


def samples(pitch: int, band: int) -> bytes:
    """The peak as float32, and int16 samples, little-endian, faded out at their end.

    `band`, below `NUM_BANDS`, is of velocities.
    """
    seconds = next(seconds for above, seconds in _SECONDS.items() if pitch < above)
    middle = (band + 0.5) * _BAND  # velocity
    sound = tone(pitch, middle / (_NUM_VELOCITIES - 1), seconds, _RATE)
    fade = int(_FADE * _RATE)
    sound[-fade:] *= np.linspace(1, 0, fade, dtype=np.float32)
    peak = float(np.abs(sound).max())
    return struct.pack("<f", peak) + np.rint(sound / peak * _LOUDEST).astype("<i2").tobytes()


class Synthesizer:
    """A maker of one tone after the other, in a process.

    The server must not make them itself: as it starts processes, products of matrices on threads
    may hang for ever.
    """

    def __init__(self) -> None:
        self._limiter = CapacityLimiter(1)

    async def tone(self, pitch: int, band: int) -> bytes:
        """The samples of a tone, see `samples`.

        Raises CadenzaError if there is no such tone, or the process has ended.
        """
        if pitch not in range(NUM_PITCHES) or band not in range(NUM_BANDS):
            raise CadenzaError("there is no such tone")
        try:
            return await to_process.run_sync(
                samples, pitch, band, cancellable=True, limiter=self._limiter
            )
        except BrokenWorkerProcess as error:
            raise CadenzaError("the tone cannot be made") from error
