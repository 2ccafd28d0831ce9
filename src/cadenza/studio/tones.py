"""The sound of a key as the page has it: samples that Web Audio strikes and damps.

As a process of its own, `python -m cadenza.studio.tones`, it reads pitch and band, two bytes, and
answers with the size of the samples and the samples, again and again. The server must not make
them itself: it starts processes, and what multiplies matrices on threads may then stand for ever.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
from typing import Any

import numpy as np

from cadenza.report.tone import DAMPING, LAST_DAMPER, LOUDER, tone

_RATE = 32_000  # [Hz]
_SECONDS = {60: 5.0, 84: 3.5, 128: 2.0}  # [s] that tones last below a pitch: high ones die sooner
_FADE = 0.5  # [s] at its end
_BAND = 32  # velocities that share a tone
BANDS = 128 // _BAND
SIZE = struct.Struct("<I")
INSTRUMENT: dict[str, Any] = {
    "rate": _RATE,
    "band": _BAND,
    "damping": DAMPING,
    "last_damper": LAST_DAMPER,
    "louder": LOUDER,
}
"""What the page has to know of it."""


def samples(pitch: int, band: int) -> bytes:
    """Peak as float32, and int16 samples, little-endian, faded at their end.

    Args:
        pitch: as MIDI counts.
        band: of velocities, below `BANDS`.
    """
    seconds = next(seconds for above, seconds in _SECONDS.items() if pitch < above)
    sound = tone(pitch, (band + 0.5) * _BAND / 127, seconds, _RATE)
    fade = int(_FADE * _RATE)
    sound[-fade:] *= np.linspace(1, 0, fade, dtype=np.float32)
    peak = float(np.abs(sound).max())
    return struct.pack("<f", peak) + np.rint(sound / peak * 32767).astype("<i2").tobytes()


def main() -> None:
    """See above."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which kills this
    with os.fdopen(os.dup(1), "wb") as out:
        while asked := sys.stdin.buffer.read(2):
            made = samples(*asked)
            out.write(SIZE.pack(len(made)) + made)
            out.flush()


if __name__ == "__main__":
    main()
