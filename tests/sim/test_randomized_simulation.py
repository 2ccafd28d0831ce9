"""Simulations with models of their own and controls that come late."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from random_controls import assert_same, controls, drawn

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.hands_apart import HandsApart
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.planning_simulation import PlanningSimulation
from cadenza.sim.protocol import HeldControls


def randomized(scene: Scene, seed: int) -> MujocoSimulation:
    simulation = MujocoSimulation(scene)
    simulation.randomize(0, drawn(scene, seed))
    simulation.reset()
    return simulation


def test_randomizing_again_is_as_if_it_were_the_first_time(scene):
    again, fresh = randomized(scene, 1), randomized(scene, 2)
    for ctrl in controls(scene, 1):
        again.step(ctrl)
    again.randomize(0, drawn(scene, 2))
    again.reset()
    for ctrl in controls(scene, 1):
        again.step(ctrl)
        fresh.step(ctrl)
    assert_same(again.state, fresh.state)


def test_a_planner_takes_over_the_state_and_not_the_model(scene):
    simulation = randomized(scene, 1)
    for ctrl in controls(scene, 1):
        simulation.step(ctrl)
    taken, put = PlanningSimulation(scene), PlanningSimulation(scene)
    taken.copy_from(simulation, 0)
    put.set_physics_state(simulation.physics_state(0))
    assert_array_equal(taken.state.hand_qpos, simulation.state.hand_qpos)
    ctrl = next(controls(scene, 1, seed=1))
    for each in (taken, put, simulation):
        each.step(ctrl)
    assert_allclose(taken.state.hand_qpos, put.state.hand_qpos, atol=1e-12)
    assert np.abs(taken.state.hand_qpos - simulation.state.hand_qpos).max() > 1e-4


@pytest.mark.parametrize("late", [0, 1, 3, 9])
def test_late_controls_are_those_of_mujoco_stepped_by_hand(scene, late):
    simulation, data = MujocoSimulation(scene), mujoco.MjData(scene.model)
    (before,), (then,), *_ = controls(scene, 1)
    simulation.step(then[None], None, HeldControls(before[None], np.array([late])))
    for k in range(10):
        data.ctrl = before if k < late else then
        mujoco.mj_step(scene.model, data)
    assert_allclose(simulation.state.hand_qpos[0], data.qpos[scene.hand_qpos], atol=1e-12)


def test_hands_apart_are_randomized_as_they_are_together():
    """Off the keys and each other, hands at two pianos move as at one."""
    factors = drawn(build_scene(), 1)
    states = []
    for hands, kind in (("both", MujocoSimulation), ("apart", HandsApart)):
        scene = build_scene(SceneConfig(hands=hands))  # type: ignore[arg-type]
        simulation = kind(scene)
        simulation.randomize(0, factors)
        simulation.reset([0], scene.hand_start[None])
        for _ in range(4):
            simulation.step(np.clip(0.05, scene.action_low, scene.action_high)[None, :-1])
        states.append(simulation.state.hand_qpos)
    assert_allclose(states[1], states[0], atol=1e-4)
