"""The best of several takes, put together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cadenza.agents.planner.practice.plan_variants import better_windows, patched
from cadenza.agents.planner.practice.trajectory import Trajectory

STEPS, KEYS, WINDOW = 23, 5, 4
SERVOS = [slice(0, 3), slice(3, 6)]


class Part:
    """What a hand has to do: every other key."""

    def __init__(self, hand: int) -> None:
        self.mine = np.zeros((STEPS, KEYS), bool)
        self.mine[:, hand::2] = True


PARTS: Any = [Part(0), Part(1)]


def take(rng: np.random.Generator) -> Trajectory:
    return Trajectory(
        rng.random((STEPS, 6)),
        rng.random((STEPS, 6, 2)),
        rng.random((STEPS, KEYS)) < 0.5,
        rng.choice([0.0, 0.5, 1.0], (STEPS, 2)),
        rng.random(STEPS),
    )


@pytest.mark.parametrize("seed", range(5))
def test_each_hand_keeps_the_better_of_each_window(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = take(rng), take(rng)
    before = one.part(0, STEPS)
    unlike = rng.random((STEPS, 2)) < 0.05
    where = better_windows(one.loss, other.loss, unlike, WINDOW)
    best = patched(one, other, where, PARTS, SERVOS)
    for begin in range(0, STEPS, WINDOW):
        rows = slice(begin, begin + WINDOW)
        for hand, servos in enumerate(SERVOS):
            theirs = other.loss[rows, hand].sum() < one.loss[rows, hand].sum()
            kept = other if theirs and not unlike[rows, hand].any() else one
            for name in ("ctrl", "expected"):
                there, wanted = (getattr(each, name)[rows, servos] for each in (best, kept))
                np.testing.assert_array_equal(there, wanted)
            np.testing.assert_array_equal(best.loss[rows, hand], kept.loss[rows, hand])
            mine = PARTS[hand].mine[0]
            np.testing.assert_array_equal(best.sounding[rows, mine], kept.sounding[rows, mine])
    for was, now in zip(before, one, strict=True):
        np.testing.assert_array_equal(was, now)  # the takes stay as they are
