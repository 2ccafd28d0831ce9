"""Where the 88 keys lie, for whoever thinks about hands without a model of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cadenza.music.score import NUM_KEYS

WHITE_SPACING = 0.0235  # [m] from one white key's centre to the next

IS_BLACK: NDArray[np.bool_] = np.isin(np.arange(NUM_KEYS) % 12, (1, 4, 6, 9, 11))
"""(88,) which keys are black; key 0 is A0."""


def _key_y() -> NDArray[np.float64]:
    place = np.cumsum(~IS_BLACK) - 1 + 0.5 * IS_BLACK  # black keys halfway between two white ones
    return WHITE_SPACING * (place - place[-1] / 2)


KEY_Y: NDArray[np.float64] = _key_y()
"""(88,) the keys' centres along the keyboard, 0 in its middle, to the player's right [m].

The model's black keys stand up to 0.5 mm further to the right.
"""


def note_name(key: int) -> str:
    """Such as C4 for the middle C, key 39; black keys by their sharps."""
    names = ("C", "C♯", "D", "D♯", "E", "F", "F♯", "G", "G♯", "A", "A♯", "B")
    return f"{names[(key + 9) % 12]}{(key + 9) // 12}"
