"""The best of several takes, hand by hand, as one take.

No hands have played it like that. Those that follow it, with feedback, come near it, and search
where less would sound.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.plan.hand_goals import HandGoals
from cadenza.agents.planner.practice.trajectory import Trajectory

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def patched(
    take: Trajectory,
    other: Trajectory,
    where: Mask,
    parts: Sequence[HandGoals],
    servos: Sequence[slice],
) -> Trajectory:
    """A take with some steps of each hand from another take.

    Its costs are those of the first: costs are of all hands at once.

    Args:
        take: T steps.
        other: of the same song.
        where: (T, H) the steps of each hand that come from there.
        parts: of the H hands in the other take.
        servos: which of all are each hand's.
    """
    result = take.part(0, len(take.loss))
    for hand, (part, own) in enumerate(zip(parts, servos, strict=True)):
        rows = where[:, hand]
        result.ctrl[rows, own] = other.ctrl[rows, own]
        result.expected[rows, own] = other.expected[rows, own]
        result.loss[rows, hand] = other.loss[rows, hand]
        keys = part.mine & rows[:, None]
        result.sounding[keys] = other.sounding[keys]
    return result


def better_windows(loss: Array, other: Array, unlike: Mask, window: int) -> Mask:
    """(T, H) the windows of each hand in which another take loses less.

    Args:
        loss: (T, H) of a take.
        other: (T, H) loss of the other one.
        unlike: (T, H) where hands play with other fingers; windows with such a step stay.
        window: in steps.
    """
    begins = np.arange(0, len(loss), window)
    mine, others = (np.add.reduceat(each, begins) for each in (loss, other))
    better = (others < mine) & ~np.logical_or.reduceat(unlike, begins)
    return np.repeat(better, window, axis=0)[: len(loss)]
