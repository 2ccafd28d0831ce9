"""Scaled models: what is off, by how much, and what stays."""

from copy import copy

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.scene.config import SceneConfig
from cadenza.scene.randomization import SCALED_FIELDS, Factors, scale, shapes
from cadenza.scene.scene import Scene, build_scene
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation

KEPT = ("body_pos", "jnt_range", "geom_size", "actuator_ctrlrange", "actuator_forcerange", "qpos0")


@pytest.fixture(scope="module")
def scene():
    return build_scene(SceneConfig(hands="right"))


def drawn(scene: Scene, seed: int, amount: float = 0.1) -> Factors:
    rng = np.random.default_rng(seed)
    known = {name: shape for name, shape in shapes(scene).items() if name in SCALED_FIELDS}
    return {n: np.asarray(rng.uniform(1 - amount, 1 + amount, s)) for n, s in known.items()}


def scaled(scene: Scene, factors: Factors) -> mujoco.MjModel:
    model = copy(scene.model)
    scale(model, scene, factors, mujoco.MjData(model))
    return model


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """All arrays of a compiled model."""
    names = [name for name in dir(model) if not name.startswith("_")]
    values = {name: getattr(model, name) for name in names}
    return {name: v.copy() for name, v in values.items() if isinstance(v, np.ndarray)}


def test_factors_of_one_change_no_bit(scene):
    there = arrays(scaled(scene, drawn(scene, 0, 0.0)))
    for name, values in arrays(scene.model).items():
        assert_array_equal(values, there[name], err_msg=name)


@pytest.mark.parametrize("what", SCALED_FIELDS)
def test_one_thing_is_scaled_and_nothing_else(scene, what):
    before, factor = arrays(scene.model), drawn(scene, 0)[what]
    there = arrays(scaled(scene, {what: factor}))
    for name, values in arrays(scene.model).items():
        assert_array_equal(before[name], values, err_msg=name)
    keys = slice(0, 88) if what in ("key_spring", "key_travel") else slice(None)
    for name in SCALED_FIELDS[what]:
        assert_allclose(there[name][keys], (before[name][keys].T * factor).T, rtol=1e-15)
    fields = {*KEPT, *(name for names in SCALED_FIELDS.values() for name in names)}
    for name in fields - {*SCALED_FIELDS[what]}:
        assert_array_equal(before[name], there[name], err_msg=name)


def test_nothing_adds_up(scene):
    model, data = copy(scene.model), mujoco.MjData(scene.model)
    for seed in (3, 4, 5):
        scale(model, scene, drawn(scene, seed), data)
    for name, values in arrays(scaled(scene, drawn(scene, 5))).items():
        assert_array_equal(arrays(model)[name], values, err_msg=name)


def test_what_follows_from_masses_follows(scene):
    """MuJoCo's own sums of the masses below a body, and its inertia matrix."""
    model = scaled(scene, drawn(scene, 1))
    assert_allclose(model.body_subtreemass[0], model.body_mass.sum())
    data, inertia = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    assert_allclose(model.dof_M0, np.diag(inertia))


def test_servos_come_to_rest_where_they_did(scene):
    """How two joints share what their tendon asks for, damping decides on the way there."""
    ctrl = np.array([0.2, *scene.action_low[:-1][1:] * 0.5 + scene.action_high[:-1][1:] * 0.5])
    ctrl[-2:] = 0.1, -0.3  # the forearm, off the keys
    rest = []
    for factors in (None, drawn(scene, 2, 0.3)):
        simulation = PlanningSimulation(scene)
        if factors is not None:
            simulation.randomize(0, factors)
            simulation.reset([0])
        simulation.rollout(np.tile(ctrl, (1, 60, 1)))
        rest.append(simulation.state.hand_qpos[0] @ np.linalg.pinv(servos_of(scene).joints))
    assert np.abs(simulation.state.hand_qvel).max() < 1e-2
    assert_allclose(rest[1], rest[0], atol=1e-3)
