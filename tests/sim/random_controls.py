"""What simulations are driven by, and what it takes for them to end alike."""

from collections.abc import Iterator

import numpy as np
from numpy.testing import assert_array_equal

from cadenza.scene.randomization import POSE_FIELDS, Factors, shapes
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import State

STEPS = 12


def controls(scene: Scene, num_envs: int, seed: int = 0) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(seed)
    low, high = scene.action_low[:-1], scene.action_high[:-1]
    for _ in range(STEPS):
        yield rng.uniform(low, high, (num_envs, len(low)))


def drawn(scene: Scene, seed: int) -> Factors:
    """What the model of a scene differs by."""
    rng = np.random.default_rng(seed)
    factors = {name: np.asarray(rng.uniform(0.7, 1.4, s)) for name, s in shapes(scene).items()}
    return {n: (f - 1) * 0.02 if n in POSE_FIELDS else f for n, f in factors.items()}  # [m, rad]


def assert_same(a: State, b: State, rows: slice = slice(None)) -> None:
    for field, left, right in zip(State._fields, a, b, strict=True):
        assert_array_equal(left[rows], right[rows], err_msg=field)
