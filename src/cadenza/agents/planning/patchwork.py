"""The best of several takes, window by window and hand by hand, as one take.

No hands have played it like that. Those that follow it, with feedback, come near it, and search
where less would sound.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadenza.agents.planning.hand_part import HandPart
from cadenza.agents.planning.takes import Take


def patched(
    take: Take, other: Take, parts: Sequence[HandPart], servos: Sequence[slice], window: int
) -> Take:
    """A take with those windows of each hand from another take in which that one loses less.

    Its costs are those of the first: costs are of all hands at once.

    Args:
        take: T steps.
        other: of the same song, with the same fingers.
        parts: of the H hands.
        servos: which of all are each hand's.
        window: in steps.
    """
    begins = np.arange(0, len(take.loss), window)
    loss, others = (np.add.reduceat(each.loss, begins) for each in (take, other))
    better = np.repeat(others < loss, window, axis=0)[: len(take.loss)]  # (T, H)
    result = take.part(0, len(take.loss))
    for hand, (part, own) in enumerate(zip(parts, servos, strict=True)):
        rows = better[:, hand]
        result.ctrl[rows, own] = other.ctrl[rows, own]
        result.expected[rows, own] = other.expected[rows, own]
        result.loss[rows, hand] = other.loss[rows, hand]
        keys = part.mine & rows[:, None]
        result.sounding[keys] = other.sounding[keys]
    return result
