"""The engine for GPUs on the CPU: a recorded performance, resets, and what goes wrong."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.scene.randomization import POSE_FIELDS, shapes
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.protocol import HeldControls

pytestmark = pytest.mark.slow  # it compiles for a minute
pytest.importorskip("mujoco_warp")

DATA = Path(__file__).parents[1] / "data"
POSITIONS = 1e-4  # [m, rad] by which single precision and keys that never sleep may differ
SPEEDS = 0.05  # [m/s, rad/s], where fingers meet keys
TIMES = 1e-4  # [s] of onsets
STEPS = 40
FACTORS = 0.7, 1.4


@pytest.fixture(scope="module")
def ctrl():
    with np.load(DATA / "episode_d.npz") as recorded:
        return recorded["action"][:STEPS, :-1]


def test_a_performance_resets_and_a_world_that_diverges(scene, ctrl):
    """In one test, as each batch compiles anew."""
    from cadenza.sim.warp import WarpSimulation

    simulation = WarpSimulation(scene, 3, watch_forearms=True)
    nominal = MujocoSimulation(scene, 1, watch_forearms=True)
    start = np.tile(scene.hand_start, (3, 1))
    nominal.reset([0], start[:1])
    simulation.reset([0, 1, 2], start)
    assert_allclose(simulation.state.fingertip_xpos[1], nominal.state.fingertip_xpos[0])
    onsets = 0
    for step, row in enumerate(ctrl):
        nominal.step(row[None])
        given = np.tile(row, (3, 1))
        if step == 10:
            given[2] = np.nan
        simulation.step(given, [0, 2] if step % 2 else None)
        ours, theirs = simulation.state, nominal.state
        for name in ("key_qpos", "key_xpos", "hand_qpos", "fingertip_xpos"):
            expected, actual = getattr(theirs, name)[0], getattr(ours, name)[0]
            assert_allclose(actual, expected, atol=POSITIONS, err_msg=f"{name} {step}")
        for name in ("hand_qvel", "actuator_velocity", "actuator_force"):
            expected, actual = getattr(theirs, name)[0], getattr(ours, name)[0]
            assert_allclose(actual, expected, atol=SPEEDS, err_msg=f"{name} {step}")
        assert_array_equal(np.isnan(ours.key_onset[0]), np.isnan(theirs.key_onset[0]))
        assert_allclose(ours.key_onset[0], theirs.key_onset[0], atol=TIMES)
        assert_array_equal(ours.forearm_contact[0], theirs.forearm_contact[0])
        assert_array_equal(ours.unstable, [False, False, step >= 10])
        assert all(np.isfinite(ours.hand_qpos[2]))
        onsets += np.isfinite(ours.key_onset[0]).sum()
    assert onsets > 3
    assert abs(simulation.state.hand_qpos[1] - simulation.state.hand_qpos[0]).max() > 0.01
    simulation.reset([2], start[:1])
    assert not simulation.state.unstable.any()
    simulation.step(np.tile(ctrl[0], (3, 1)))
    nominal.reset([0], start[:1])
    nominal.step(ctrl[:1])
    assert_allclose(simulation.state.hand_qpos[2], nominal.state.hand_qpos[0], atol=POSITIONS)


def test_contacts_without_room_are_told(scene, ctrl):
    from cadenza.sim.warp import Buffers, WarpPhysics

    physics = WarpPhysics(scene, 1, buffers=Buffers(rows=120))
    state = physics.start(scene.hand_start)
    state, read = physics.step(state, ctrl[:1])
    assert_array_equal(read.unstable, [True])
    assert state.overflow[0]


def test_randomized_worlds_with_late_controls(scene, ctrl):
    """Each as in C with the same factors, and not as another one."""
    from cadenza.sim.warp import WarpSimulation

    ours, theirs = WarpSimulation(scene, 2), MujocoSimulation(scene, 2)
    for env in range(2):
        rng = np.random.default_rng(env)
        factors = {
            name: np.asarray(rng.uniform(*((-0.002, 0.002) if name in POSE_FIELDS else FACTORS), s))
            for name, s in shapes(scene).items()
        }
        for each in (ours, theirs):
            each.randomize(env, factors)
            each.reset([env], scene.hand_start[None])
    late = np.array([3, 9])
    for before, row in itertools.pairwise(ctrl[:9]):
        for each in (ours, theirs):
            each.step(np.tile(row, (2, 1)), None, HeldControls(np.tile(before, (2, 1)), late))
        for name in ("key_qpos", "hand_qpos", "fingertip_xpos"):
            actual, expected = getattr(ours.state, name), getattr(theirs.state, name)
            assert_allclose(actual, expected, atol=POSITIONS, err_msg=name)
    assert abs(theirs.state.hand_qpos[0] - theirs.state.hand_qpos[1]).max() > 0.01
