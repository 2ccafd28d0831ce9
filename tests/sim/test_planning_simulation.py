"""What planners do to simulations: copies, states that are set, and rollouts."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from random_controls import STEPS, assert_same, controls

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene, in_steps_of
from cadenza.sim.mujoco_simulation import PHYSICS_STATE
from cadenza.sim.planning_simulation import PlanningSimulation

DATA = Path(__file__).parents[1] / "data"


@pytest.mark.parametrize("num_threads", [1, 2])
def test_rollout_is_many_steps(scene, num_threads):
    ctrl = np.stack(list(controls(scene, 3)), axis=1)
    rolled = PlanningSimulation(scene, 3, num_threads=num_threads)
    stepped = PlanningSimulation(scene, 3)
    states = rolled.rollout(ctrl)
    for k in range(STEPS):
        stepped.step(ctrl[:, k])
        for ours, alone in zip(states, stepped.state, strict=True):
            assert_array_equal(ours[:, k], alone)
    assert_same(rolled.state, stepped.state)


def test_copies_the_state_of_another(scene):
    original = PlanningSimulation(scene, 1)
    copies = PlanningSimulation(scene, 3, control_timestep=0.01)
    for ctrl in controls(scene, 1):
        original.step(ctrl)
    copies.copy_from(original, 0)
    for i in range(3):
        assert_array_equal(copies.state.hand_qpos[i], original.state.hand_qpos[0])
    ctrl = next(controls(scene, 1, seed=5))
    original.step(ctrl)
    for _ in range(5):
        copies.step(np.tile(ctrl, (3, 1)))
    assert_array_equal(copies.state.key_qpos[2], original.state.key_qpos[0])


def test_looks_ahead_in_coarser_steps():
    """As MuJoCo does from that state with the other timestep, among keys that fingers press."""
    scene = build_scene(SceneConfig(sleeping_keys=False))
    original = PlanningSimulation(scene)
    with np.load(DATA / "episode_d.npz") as recorded:
        actions = recorded["action"][:41, None, :-1]
    for ctrl in actions:
        original.step(ctrl)
    assert original.state.key_qpos.max() > 0.01
    coarse = in_steps_of(scene, 0.01)
    ahead = PlanningSimulation(coarse, 1, control_timestep=0.01)
    ahead.copy_from(original, 0)
    data = mujoco.MjData(coarse.model)
    mujoco.mj_setState(coarse.model, data, original.physics_state(0), PHYSICS_STATE)
    data.ctrl = actions[-1, 0]
    for _ in range(5):
        ahead.step(actions[-1])
        mujoco.mj_step(coarse.model, data)
    assert_array_equal(ahead.state.key_qpos[0], data.qpos[scene.key_qpos])
    assert scene.model.opt.timestep == 0.005


@pytest.mark.parametrize("sleeping", [False, True])
def test_another_scene_goes_on_from_a_physics_state(sleeping):
    """To the bit where keys never sleep, and closely where they did."""
    waking = build_scene(SceneConfig(sleeping_keys=False))
    original = PlanningSimulation(build_scene(SceneConfig(sleeping_keys=sleeping)))
    for ctrl in controls(waking, 1):
        original.step(ctrl)
    others = PlanningSimulation(waking, 2)
    others.set_physics_state(original.physics_state(0))
    for ctrl in list(controls(waking, 1, seed=5))[:2]:
        original.step(ctrl)
        others.step(np.tile(ctrl, (2, 1)))
    for expected, actual in zip(original.state, others.state, strict=True):
        assert_allclose(actual[1], expected[0], rtol=0, atol=1e-3 * sleeping)


def test_coordinates_are_those_of_keys_and_hands(scene):
    simulation = PlanningSimulation(scene, 2)
    for ctrl in controls(scene, 2):
        simulation.step(ctrl)
    positions, velocities = np.split(simulation.coordinates(), 2, axis=1)
    assert_array_equal(positions[:, scene.key_qpos], simulation.state.key_qpos)
    assert_array_equal(positions[:, scene.hand_qpos], simulation.state.hand_qpos)
    assert_array_equal(velocities[:, scene.hand_qvel], simulation.state.hand_qvel)


def test_joints_that_are_set_have_no_past(scene):
    """Two simulations with different pasts go on alike, from the joints that were asked for."""
    used, fresh = PlanningSimulation(scene, 1), PlanningSimulation(scene, 1)
    for ctrl in controls(scene, 1, seed=1):
        used.step(ctrl)
    rng, joints = np.random.default_rng(0), len(scene.hand_joint_names)
    place = (
        0.01 * rng.standard_normal(joints),
        rng.standard_normal(joints),
        np.linspace(0, 0.05, 88),
    )
    for simulation in (used, fresh):
        simulation.set_joints(*place)
        for name, expected in zip(("hand_qpos", "hand_qvel", "key_qpos"), place, strict=True):
            assert_array_equal(getattr(simulation.state, name)[0], expected)
        for ctrl in controls(scene, 1):
            simulation.step(ctrl)
    assert_same(used.state, fresh.state)
