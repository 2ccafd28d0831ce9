"""When an episode of a drill counts as a success."""

import numpy as np
import pytest

from benchmarks.drills import succeeds

GOAL = np.zeros((12, 3), bool)
GOAL[2:6, 0] = GOAL[7:11, 1] = True


def sounding(*wrong: tuple[int, int]) -> np.ndarray:
    """What should sound, but for these steps and keys."""
    result = GOAL.copy()
    for place in wrong:
        result[place] = ~result[place]
    return result


@pytest.mark.parametrize(
    ("wrong", "success"),
    [
        ((), True),
        (((1, 0), (6, 0)), True),  # a step too early and too late
        (((2, 0), (3, 0)), True),  # half of a note
        (((2, 0), (3, 0), (4, 0)), False),
        (((8, 0),), False),  # a key that was right before
        (((3, 2),), False),
    ],
)
def test_all_keys_have_to_be_right(wrong, success):
    assert succeeds(GOAL, sounding(*wrong)) == success
