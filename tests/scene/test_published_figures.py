"""The scene has the masses, joints, servos and colliding shapes of the published system."""

import json
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene

DATA = Path(__file__).parents[1] / "data"
TOLERANCE = {"rtol": 1e-6, "atol": 2e-9}
HANDS = [(reduced, side) for reduced in ("full", "reduced") for side in ("right", "left")]


@pytest.fixture(scope="module")
def scenes():
    return {
        "full": build_scene(SceneConfig(reduced_action_space=False)),
        "reduced": build_scene(SceneConfig(reduced_action_space=True)),
    }


def figures(name: str) -> dict:
    return json.loads((DATA / f"{name}.json").read_text())


def hand_name(side: str) -> Callable[[str], str]:
    """Maps the published names of one hand's parts to ours."""
    prefix = "rh_" if side == "right" else "lh_"

    def ours(name: str) -> str:
        bare = name.split("/", 1)[1].removeprefix(prefix)
        return f"{prefix}A_{bare}" if bare.startswith("A_forearm") else prefix + bare

    return ours


def key_name(published: str) -> str:
    return published.split("/", 1)[1].replace("_joint_", "_key_").replace("_site_", "_")


def check_bodies(model: mujoco.MjModel, bodies: list[dict], ours: Callable[[str], str]) -> None:
    massless_mounts = [b for b in bodies if b["name"].endswith("/")]
    assert all(b["mass"] == 0 for b in massless_mounts)
    for figure in bodies:
        if figure in massless_mounts:
            continue
        body = model.body(ours(figure["name"]))
        assert_allclose(body.pos, figure["pos"], **TOLERANCE)
        assert_same_turn(body.quat, figure["quat_wxyz"])
        assert_allclose(body.mass, figure["mass"], **TOLERANCE)
        assert_allclose(body.ipos, figure["inertia_pos"], **TOLERANCE)
        assert_allclose(
            inertia_tensor(body.iquat, body.inertia),
            inertia_tensor(figure["inertia_quat_wxyz"], figure["diag_inertia"]),
            rtol=1e-5,
            atol=1e-9,
        )
        assert model.body_gravcomp[body.id] == figure["gravcomp"]
        if not figure["parent"].endswith("/") and figure["parent"] != "world":
            assert model.body(body.parentid[0]).name == ours(figure["parent"])


def inertia_tensor(quat, diagonal) -> np.ndarray:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.array(quat, float))
    rotation = rotation.reshape(3, 3)
    return rotation @ np.diag(diagonal) @ rotation.T


def assert_same_turn(ours, published) -> None:
    published = np.array(published)
    assert_allclose(abs(ours @ published / np.linalg.norm(published)), 1.0, atol=1e-6)


def check_joints(model: mujoco.MjModel, joints: list[dict], ours: Callable[[str], str]) -> None:
    kinds = {"hinge": mujoco.mjtJoint.mjJNT_HINGE, "slide": mujoco.mjtJoint.mjJNT_SLIDE}
    for figure in joints:
        joint = model.joint(ours(figure["name"]))
        dof = joint.dofadr[0]
        assert joint.type[0] == kinds[figure["type"]]
        assert bool(joint.limited[0]) == figure["limited"]
        for field in ("axis", "pos", "range", "margin"):
            assert_allclose(getattr(joint, field), figure[field], err_msg=field, **TOLERANCE)
        assert_allclose(joint.stiffness[0], figure["stiffness"])
        if figure["stiffness"]:
            assert_allclose(model.qpos_spring[joint.qposadr[0]], figure["springref"])
        for field in ("damping", "armature", "frictionloss"):
            assert_allclose(getattr(model, f"dof_{field}")[dof], figure[field], err_msg=field)
        assert (
            bool(joint.actgravcomp[0] if hasattr(joint, "actgravcomp") else 0)
            == figure["actgravcomp"]
        )
        assert_allclose(model.jnt_solref[joint.id], figure["solref_limit"])
        assert_allclose(model.jnt_solimp[joint.id], figure["solimp_limit"])


def check_geoms(model: mujoco.MjModel, geoms: list[dict], ours: Callable[[str], str]) -> None:
    kinds = {
        name: getattr(mujoco.mjtGeom, f"mjGEOM_{name.upper()}")
        for name in ("box", "capsule", "cylinder", "sphere")
    }
    by_body: dict[str, list[dict]] = {}
    for figure in geoms:
        by_body.setdefault(ours(figure["body"]), []).append(figure)
    for body, figures_of_body in by_body.items():
        ids = np.flatnonzero(model.geom_bodyid == model.body(body).id)
        ids = [g for g in ids if model.geom_contype[g] or model.geom_conaffinity[g]]
        assert len(ids) == len(figures_of_body), body
        for g, figure in zip(ids, figures_of_body, strict=True):
            if figure["type"] == "mesh":
                check_forearm_shell(model, g, figure)
            else:
                assert model.geom_type[g] == kinds[figure["type"]]
                assert_allclose(model.geom_pos[g], figure["pos"], err_msg=body, **TOLERANCE)
                assert_same_turn(model.geom_quat[g], figure["quat_wxyz"])
                used = np.array(figure["size"]) * (model.geom_size[g] > 0)
                assert_allclose(model.geom_size[g], used, err_msg=body, **TOLERANCE)
            for field in ("contype", "conaffinity", "condim", "priority"):
                assert getattr(model, f"geom_{field}")[g] == figure[field], (body, field)
            for field in ("friction", "solref", "solimp", "margin", "gap", "solmix"):
                assert_allclose(getattr(model, f"geom_{field}")[g], figure[field], err_msg=field)


def check_forearm_shell(model: mujoco.MjModel, geom: int, figure: dict) -> None:
    """The cylinder that stands for the only mesh keeps within its bounds to a millimetre or two."""
    low, high = np.array(figure["mesh_vertex_bounds_in_geom_frame"]) + figure["pos"]
    radius, half_length = model.geom_size[geom, :2]
    extent = np.array([radius, radius, half_length])
    assert_allclose(model.geom_pos[geom] - extent, low, atol=2e-3)
    assert_allclose(model.geom_pos[geom] + extent, high, atol=2e-3)


def check_actuators(model: mujoco.MjModel, actuators: list[dict], ours) -> None:
    for figure in actuators:
        bare = figure["name"].split("/", 1)[1]
        side = ours(figure["target"])[:3]
        name = f"{side}A_{bare}" if bare.startswith("forearm") else ours(figure["name"])
        actuator = model.actuator(name)
        target = model.joint if figure["transmission"] == "joint" else model.tendon
        assert target(actuator.trnid[0]).name == ours(figure["target"])
        assert_allclose(actuator.gainprm[0], figure["kp"])
        assert_allclose(actuator.biasprm[:3], figure["biasprm"])
        assert_allclose(actuator.ctrlrange, figure["ctrlrange"], **TOLERANCE)
        assert bool(actuator.forcelimited[0]) == figure["forcelimited"]
        assert_allclose(actuator.forcerange, figure["forcerange"])


@pytest.mark.parametrize(("space", "side"), HANDS)
def test_hand(scenes, space, side):
    hand = figures(f"shadow_hands_{space}")[side]
    scene, model, ours = scenes[space], scenes[space].model, hand_name(side)
    check_bodies(model, hand["bodies"], ours)
    check_joints(model, hand["joints"], ours)
    check_geoms(model, hand["geoms"], ours)
    check_actuators(model, hand["actuators"], ours)
    prefix = ours("x/")
    assert [ours(j["name"]) for j in hand["joints"]] == [
        name for name in scene.hand_joint_names if name.startswith(prefix)
    ]
    assert len(hand["actuators"]) == sum(n.startswith(prefix) for n in scene.actuator_names)
    for figure in hand["tendons"]:
        tendon = model.tendon(ours(figure["name"])).id
        first, count = model.tendon_adr[tendon], model.tendon_num[tendon]
        joints = [model.joint(j).name for j in model.wrap_objid[first : first + count]]
        assert joints == [ours(name) for name, _ in figure["joints"]]
        assert_allclose(model.wrap_prm[first : first + count], [c for _, c in figure["joints"]])
    excluded = {tuple(sorted(ours(b) for b in pair)) for pair in hand["excludes"]}
    assert excluded <= excluded_pairs(model)
    tips = {s["name"].split("/")[1].removesuffix("distal_site"): s for s in hand["sites"]}
    for finger in ("th", "ff", "mf", "rf", "lf"):
        assert_allclose(model.site(f"{prefix}{finger}tip").pos, tips[finger]["pos"])


def excluded_pairs(model: mujoco.MjModel) -> set[tuple[str, ...]]:
    pairs = ((s >> 16, s & 0xFFFF) for s in model.exclude_signature)
    return {tuple(sorted(model.body(b).name for b in pair)) for pair in pairs}


def test_nothing_else_is_excluded(scenes):
    assert len(excluded_pairs(scenes["full"].model)) == 4


def test_piano(scenes):
    piano, model = figures("piano"), scenes["full"].model
    assert len(piano["joints"]) == 88
    check_bodies(model, piano["bodies"], key_name)
    check_joints(model, piano["joints"], key_name)
    check_geoms(model, piano["geoms"], key_name)


def test_options(scenes):
    published, options = figures("scene"), scenes["full"].model.opt
    for field in ("timestep", "gravity", "impratio", "iterations", "tolerance", "ls_iterations"):
        assert_allclose(getattr(options, field), published[field], err_msg=field)
    assert mujoco.mjtIntegrator(options.integrator).name == published["integrator"]
    assert mujoco.mjtCone(options.cone).name == published["cone"]
    assert mujoco.mjtSolver(options.solver).name == published["solver"]
    assert scenes["full"].model.nu == published["nu"]
    assert scenes["full"].model.nv == published["nv"]
    for camera in published["cameras"]:
        ours = scenes["full"].model.camera(camera["name"].split("/")[1])
        assert_allclose(ours.pos, camera["pos"], atol=1e-6)
        assert_same_turn(ours.quat, camera["quat_wxyz"])
        assert_allclose(ours.fovy, camera["fovy"], atol=1e-4)
