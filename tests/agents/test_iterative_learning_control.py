"""Updates of controls by the fingertip errors of a rollout."""

import numpy as np
import pytest

from cadenza.agents.planner.plan.tracking import discretised
from cadenza.agents.planner.search.fingertip_correction import CONTROL_TOLERANCE, control_update
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene, hand_alone
from cadenza.scene.servos import servos_of

DT, STEPS, FINGERS = 0.05, 6, 5


@pytest.fixture(scope="module")
def alone():
    return hand_alone(build_scene(SceneConfig()), "right").scene


def test_least_squares_over_all_steps_at_once(alone):
    servos, rng = servos_of(alone), np.random.default_rng(0)
    count = len(servos.low)
    off = 0.01 * rng.standard_normal((STEPS, FINGERS, 3))
    weight = rng.random((STEPS, FINGERS))
    motion = 0.05 * rng.standard_normal((STEPS, FINGERS, 3, count))
    gain = 0.2 * rng.random((STEPS, count, 2))
    step, push = discretised(servos, DT)

    def led_to(change: np.ndarray) -> np.ndarray:
        """(STEPS, FINGERS, 3) where changes (STEPS, A) take fingertips: step by step."""
        state, there = np.zeros((count, 2)), []
        for t in range(STEPS):
            ctrl = change[t] - (gain[t] * state).sum(axis=1)
            state = np.einsum("aij,aj->ai", step, state) + push * ctrl[:, None]
            there.append(motion[t] @ state[:, 0])
        return np.array(there)

    response = np.array(
        [led_to(unit.reshape(STEPS, count)).ravel() for unit in np.eye(STEPS * count)]
    ).T
    root = np.repeat(np.sqrt(weight), 3, axis=1).ravel() / CONTROL_TOLERANCE
    rows = np.concatenate([root[:, None] * response, np.diag(np.tile(1 / servos.noise, STEPS))])
    wanted = np.concatenate([root * off.ravel(), np.zeros(STEPS * count)])
    expected = np.linalg.lstsq(rows, wanted, rcond=None)[0].reshape(STEPS, count)
    found = control_update(off, weight, motion, gain, servos, DT)
    np.testing.assert_allclose(found, expected, atol=1e-9)
