"""The sound of a key as the page plays it: samples that Web Audio starts and damps.

Imports no library of the studio's server: `cadenza play` sends the settings to its live page, too.
"""

import struct
from typing import Any

import numpy as np

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
    """Return the peak as float32, and int16 samples, little-endian, faded out at their end.

    `band`, below `NUM_BANDS`, is of velocities.
    """
    seconds = next(seconds for above, seconds in _SECONDS.items() if pitch < above)
    middle = (band + 0.5) * _BAND  # velocity
    sound = tone(pitch, middle / (_NUM_VELOCITIES - 1), seconds, _RATE)
    fade = int(_FADE * _RATE)
    sound[-fade:] *= np.linspace(1, 0, fade, dtype=np.float32)
    peak = float(np.abs(sound).max())
    return struct.pack("<f", peak) + np.rint(sound / peak * _LOUDEST).astype("<i2").tobytes()
