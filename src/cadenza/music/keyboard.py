"""The colours and names of the 88 keys."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import NUM_KEYS

IS_BLACK: NDArray[np.bool_] = np.isin(np.arange(NUM_KEYS) % 12, (1, 4, 6, 9, 11))
"""(88,) which keys are black; key 0 is A0."""


def note_name(key: int) -> str:
    """Such as C4 for the middle C, key 39; black keys by their sharps."""
    names = ("C", "C♯", "D", "D♯", "E", "F", "F♯", "G", "G♯", "A", "A♯", "B")
    return f"{names[(key + 9) % 12]}{(key + 9) // 12}"
