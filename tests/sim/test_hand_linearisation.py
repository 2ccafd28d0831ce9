"""Derivatives by the hands against the simulation itself, where it is smooth."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.hand_linearisation import HandLineariser
from cadenza.sim.planning_simulation import PlanningSimulation

DT = 0.05


@pytest.fixture(scope="module")
def scene() -> Scene:
    """Without dry friction; the hand is above the keys where it starts."""
    return build_scene(SceneConfig(hands="right", physics="fast"))


@pytest.fixture(scope="module")
def ctrl(scene: Scene) -> np.ndarray:
    middle = (scene.action_low + scene.action_high)[:-1] / 2
    return np.array([0.2 * middle, 0.3 * middle])


def sizes(scene: Scene) -> tuple[int, int]:
    return len(scene.hand_joint_names), scene.model.nu


def test_predicts_where_hands_go_that_begin_elsewhere(scene: Scene, ctrl: np.ndarray) -> None:
    joints, servos = sizes(scene)
    start = PlanningSimulation(scene, 1, DT)
    seen = HandLineariser(scene, np.full(2 * joints + servos, 1e-5), DT).linearise(start, ctrl)
    other = PlanningSimulation(scene, 1, DT)
    z = 1e-3 * np.random.default_rng(0).standard_normal(2 * joints + servos)
    other.displace_hands(z[None, :joints], z[None, joints : 2 * joints])
    start.step(ctrl[:1])
    other.step(ctrl[:1] + z[2 * joints :])
    for seen_by, values in (
        (seen.hands[0, :joints], "hand_qpos"),
        (seen.hands[0, joints:], "hand_qvel"),
        (seen.fingertips[0], "fingertip_xpos"),
    ):
        change = getattr(other.state, values)[0] - getattr(start.state, values)[0]
        error = np.linalg.norm(seen_by @ z - change) / np.linalg.norm(change)
        assert error < 0.05, values


def test_states_are_those_of_the_simulation(scene: Scene, ctrl: np.ndarray) -> None:
    joints, servos = sizes(scene)
    start = PlanningSimulation(scene, 1, DT)
    seen = HandLineariser(scene, np.full(2 * joints + servos, 1e-3), DT).linearise(start, ctrl)
    for values, expected in zip(seen.states, start.rollout(ctrl[None]), strict=True):
        assert_array_equal(values, expected[0])


def test_a_key_follows_the_finger_on_it() -> None:
    """Pressed deeper, it goes down; keys that nobody touches have no part in it."""
    scene = build_scene(SceneConfig(hands="right"))
    joints, servos = sizes(scene)
    start, ctrl = PlanningSimulation(scene, 1, DT), np.zeros((1, servos))
    names = [name.split("A_", 1)[1] for name in scene.actuator_names]
    ctrl[0, [names.index("WRJ1"), names.index("MFJ3")]] = 0.3, 0.6
    for _ in range(20):
        start.step(ctrl)
    seen = HandLineariser(scene, np.full(2 * joints + servos, 0.02), DT).linearise(start, ctrl)
    touched = np.abs(seen.keys[0]).max(axis=1) > 1e-3
    assert touched.any()
    assert start.state.key_qpos[0, touched].max() > 0.01
    deeper = seen.keys[0, touched][:, 2 * joints + names.index("WRJ1")]
    assert deeper.max() > 0


def test_displacing_one_simulation_leaves_the_other(scene: Scene, ctrl: np.ndarray) -> None:
    by = np.zeros((2, sizes(scene)[0]))
    by[1, 2:4] = 0.1, -0.2
    simulation = PlanningSimulation(scene, 2, DT)
    simulation.step(np.repeat(ctrl[:1], 2, axis=0))
    before = simulation.state
    simulation.displace_hands(by, 2 * by)
    for name, factor in (("hand_qpos", 1), ("hand_qvel", 2)):
        moved = getattr(simulation.state, name) - getattr(before, name)
        assert_array_equal(moved[0], 0.0)
        assert_allclose(moved[1], factor * by[1], atol=1e-15)
    assert_array_equal(simulation.state.key_qpos, before.key_qpos)
    assert_array_equal(simulation.state.fingertip_xpos[0], before.fingertip_xpos[0])
    assert (simulation.state.fingertip_xpos[1] != before.fingertip_xpos[1]).any()
