"""Escape motions, and the crossover of candidates finger by finger."""

import numpy as np
import pytest

from cadenza.agents.planner.search.candidates import EscapeMotions, crossover
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of

FINGER = np.array([-1, 0, 0, 1, -1, 2])


@pytest.mark.parametrize("seed", range(20))
def test_each_finger_does_what_it_does_best(seed):
    rng = np.random.default_rng(seed)
    candidates = rng.standard_normal((6, 7, len(FINGER)))
    costs = [rng.exponential(1.0, (rng.integers(1, 8), 3)) for _ in candidates]
    best = int(rng.integers(len(candidates)))
    costs[best] = rng.exponential(1.0, (7, 3))
    expected = candidates[best].copy()
    for finger in range(3):
        gains = {
            i: costs[best][: len(cost), finger].sum() - cost[:, finger].sum()
            for i, cost in enumerate(costs)
            if len(cost) >= 3  # fewer steps do not show enough
        }
        parent = max(gains, key=lambda i: gains[i])
        if gains[parent] > 0.15:
            expected[:, finger == FINGER] = candidates[parent][:, finger == FINGER]
    child = crossover(candidates, costs, best, FINGER)
    if (expected == candidates[best]).all():
        assert not len(child)
    else:
        np.testing.assert_array_equal(child, expected[None])


def test_the_hand_goes_where_the_best_candidate_has_it():
    candidates = np.arange(2.0)[:, None, None] * np.ones((2, 7, len(FINGER)))
    costs = [np.full((7, 3), 1.0), np.zeros((7, 3))]
    np.testing.assert_array_equal(crossover(candidates, costs, 0, FINGER)[0, 0], FINGER >= 0)


def test_escape_motions_lift_what_is_caught():
    servos = servos_of(build_scene(SceneConfig(hands="right")))
    ctrl = np.tile((servos.low + servos.high) / 2, (8, 1))
    posture = ctrl[0] - 0.01
    thumb = np.arange(5) == 0
    motions, straight_up = np.split(EscapeMotions(servos, 0.05).all(ctrl, thumb, posture), 2)
    lifted = (motions != ctrl).any(axis=1)  # (M, A)
    assert lifted[:3].any()
    assert set(servos.finger[lifted[:3].any(axis=0)]) == {0}
    assert set(servos.finger[lifted[3:6].any(axis=0)]) == {-1, 0}
    assert set(servos.finger[lifted.any(axis=0)]) == {-1, 0, 1, 2, 3, 4}
    assert (motions[:, -1] == ctrl[-1]).all()  # and come back to the plan
    still = (servos.finger == 0) & ~lifted[0]
    np.testing.assert_allclose(straight_up[0, :2, still].T, [posture[still]] * 2)
    np.testing.assert_array_equal(straight_up[:, 2:], motions[:, 2:])
