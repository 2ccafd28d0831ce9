"""A batch of simulations: independent, repeatable, and robust against one that diverges."""

import logging

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from random_controls import assert_same, controls

from cadenza.errors import CadenzaError
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import State


@pytest.fixture(scope="module")
def scene():
    return build_scene()


def run(scene: Scene, num_envs: int, num_threads: int) -> State:
    simulation = MujocoSimulation(scene, num_envs, num_threads=num_threads)
    for ctrl in controls(scene, num_envs):
        simulation.step(ctrl)
    simulation.close()
    return simulation.state


@pytest.mark.parametrize("num_threads", [2, 3, 8])
def test_same_bits_for_any_number_of_threads(scene, num_threads):
    assert_same(run(scene, 5, 1), run(scene, 5, num_threads))


def test_each_simulation_is_alone(scene):
    """Row i of a batch moves as if it were the only one."""
    batch = MujocoSimulation(scene, 3)
    single = [MujocoSimulation(scene, 1) for _ in range(3)]
    for ctrl in controls(scene, 3):
        batch.step(ctrl)
        for i, simulation in enumerate(single):
            simulation.step(ctrl[i : i + 1])
    for i, simulation in enumerate(single):
        for ours, alone in zip(batch.state, simulation.state, strict=True):
            assert_array_equal(ours[i], alone[0])


def test_reset_leaves_no_trace(scene):
    used, fresh = MujocoSimulation(scene, 1), MujocoSimulation(scene, 1)
    for ctrl in controls(scene, 1, seed=1):
        used.step(ctrl)
    used.reset()
    for ctrl in controls(scene, 1):
        used.step(ctrl)
        fresh.step(ctrl)
    assert_same(used.state, fresh.state)


def test_steps_only_those_asked_for(scene):
    simulation = MujocoSimulation(scene, 2)
    before = simulation.state
    simulation.step(next(controls(scene, 2)), env_ids=[1])
    assert_array_equal(simulation.state.hand_qpos[0], before.hand_qpos[0])
    assert (simulation.state.hand_qpos[1] != before.hand_qpos[1]).any()


@pytest.mark.parametrize("num_threads", [1, 2])
def test_a_diverging_simulation_is_reported_once_and_harms_no_other(scene, num_threads, caplog):
    healthy = run(scene, 3, 1)
    simulation = PlanningSimulation(scene, 3, num_threads=num_threads)
    far_away = np.full((1, len(scene.hand_joint_names)), 1e9)  # [m, rad]
    with caplog.at_level(logging.WARNING):
        for step, ctrl in enumerate(controls(scene, 3)):
            if step == 5:
                simulation.reset([1], far_away)
            simulation.step(ctrl)
    assert_array_equal(simulation.state.unstable, [False, True, False])
    logged = [r.message for r in caplog.records if "became unstable" in r.message]
    assert logged == ["simulation 1 became unstable"]
    assert_same(simulation.state, healthy, slice(0, None, 2))
    assert np.isfinite(simulation.state.hand_qpos).all()
    simulation.reset([1])
    assert not simulation.state.unstable.any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_envs": 0}, "num_envs 0: choose 1 to"),
        ({"num_threads": 0}, "num_threads 0: choose 1 to"),
        ({"control_timestep": 0.012}, "not a multiple"),
        ({"control_timestep": 0.0}, "not a multiple"),
    ],
)
def test_says_what_is_wrong(scene, options, message):
    with pytest.raises(CadenzaError, match=message):
        MujocoSimulation(scene, **options)
