"""Perturbed scenes: what is off, by how much, and what stays."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.scene.config import SceneConfig
from cadenza.scene.perturbation import perturbed
from cadenza.scene.scene import Scene, build_scene
from cadenza.scene.servos import servos_of
from cadenza.sim.planning_simulation import PlanningSimulation

SCALED = (
    "body_mass", "body_inertia", "dof_armature", "dof_damping", "dof_frictionloss",
    "jnt_stiffness", "actuator_gainprm", "actuator_biasprm", "geom_friction",
)  # fmt: skip
KEPT = ("body_pos", "jnt_range", "geom_size", "actuator_ctrlrange", "actuator_forcerange", "qpos0")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene(SceneConfig(hands="right"))


def arrays(scene: Scene) -> dict[str, np.ndarray]:
    """All arrays of the compiled model."""
    names = [name for name in dir(scene.model) if not name.startswith("_")]
    values = {name: getattr(scene.model, name) for name in names}
    return {name: v.copy() for name, v in values.items() if isinstance(v, np.ndarray)}


def test_an_amount_of_zero_changes_no_bit(scene: Scene) -> None:
    there = arrays(perturbed(scene, np.random.default_rng(0), 0.0))
    for name, values in arrays(scene).items():
        assert_array_equal(values, there[name], err_msg=name)


def test_figures_are_off_by_up_to_the_amount_and_the_scene_stays_as_it_is(scene: Scene) -> None:
    before = arrays(scene)
    there = arrays(perturbed(scene, np.random.default_rng(0), 0.1))
    for name, values in arrays(scene).items():
        assert_array_equal(before[name], values, err_msg=name)
    for name in SCALED:
        some = before[name] != 0
        factor = there[name][some] / before[name][some]
        assert 0.9 <= factor.min() < 1.1
        assert 0.9 < factor.max() <= 1.1
        if name != "geom_friction":
            assert factor.min() < 0.92 < 1.08 < factor.max(), name
        assert_array_equal(there[name][~some], 0.0)
    for name in KEPT:
        assert_array_equal(before[name], there[name], err_msg=name)


def test_what_follows_from_masses_follows(scene: Scene) -> None:
    """MuJoCo's own sums of the masses below a body, and its inertia matrix."""
    model = perturbed(scene, np.random.default_rng(1), 0.1).model
    assert_allclose(model.body_subtreemass[0], model.body_mass.sum())
    data, inertia = mujoco.MjData(model), np.empty((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, inertia)
    assert_allclose(model.dof_M0, np.diag(inertia))


def test_servos_come_to_rest_where_they_did(scene: Scene) -> None:
    """How two joints share what their tendon asks for, damping decides on the way there."""
    ctrl = np.array([0.2, *scene.action_low[:-1][1:] * 0.5 + scene.action_high[:-1][1:] * 0.5])
    ctrl[-2:] = 0.1, -0.3  # the forearm, off the keys
    rest = []
    for each in (scene, perturbed(scene, np.random.default_rng(2), 0.3)):
        simulation = PlanningSimulation(each)
        simulation.rollout(np.tile(ctrl, (1, 60, 1)))
        rest.append(simulation.state.hand_qpos[0] @ np.linalg.pinv(servos_of(each).joints))
    assert np.abs(simulation.state.hand_qvel).max() < 1e-2
    assert_allclose(rest[1], rest[0], atol=1e-3)


def test_same_seed_same_scene(scene: Scene) -> None:
    first, second, other = (
        perturbed(scene, np.random.default_rng(seed)).model.body_mass for seed in (3, 3, 4)
    )
    assert_array_equal(first, second)
    assert (first != other).any()


@pytest.mark.parametrize("amount", [-0.1, 1.0, np.nan])
def test_an_amount_that_makes_no_sense_is_refused(scene: Scene, amount: float) -> None:
    with pytest.raises(CadenzaError, match="amount"):
        perturbed(scene, np.random.default_rng(0), amount)
