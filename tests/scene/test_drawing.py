"""What the page draws agrees with the simulation, and the case of a piano is only drawn."""

import json
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from cadenza.hands.body import Geom, Link
from cadenza.hands.shadow import SHADOW
from cadenza.keyboards.mini import MINI
from cadenza.keyboards.piano import PIANO
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import body_poses, drawing, drawn_model, key_geoms
from cadenza.scene.furniture import furniture
from cadenza.scene.scene import Scene, build_scene

EPISODE = Path(__file__).parents[1] / "data/episode_d.npz"
SIZES = {"box": 3, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "sphere": 1}


@pytest.fixture(scope="module", params=["both", "right", "left", "none"])
def scene(request):
    return build_scene(SceneConfig(hands=request.param))


def test_is_plain_json(scene):
    drawn = drawing(scene)
    assert json.loads(json.dumps(drawn, allow_nan=False)) == drawn


def test_geoms_are_fixed_to_bodies_that_there_are(scene):
    drawn = drawing(scene)
    assert drawn["bodies"] == [scene.model.body(b).name for b in scene.hand_bodies]
    moving = {part["body"] for part in (*drawn["geoms"], *drawn["shells"])}
    assert moving == set(range(len(drawn["bodies"])))
    assert not {g["body"] for g in drawn["geoms"]} & {s["body"] for s in drawn["shells"]}
    for geom in drawn["geoms"]:
        assert len(geom["size"]) == SIZES[geom["type"]]
        assert min(geom["size"]) > 0
        assert (len(geom["pos"]), len(geom["quat"]), len(geom["rgba"])) == (3, 4, 4)
        assert_allclose(np.linalg.norm(geom["quat"]), 1.0, atol=1e-5)


def test_each_finger_has_a_tip(scene):
    drawn = drawing(scene)
    tips = {
        s["finger"]: drawn["bodies"][s["body"]] for s in drawn["shells"] if s["finger"] is not None
    }
    assert sorted(tips) == list(range(10)[scene.present_fingers])
    for finger, body in tips.items():
        side = "rh_" if finger < 5 else "lh_"
        assert body == f"{side}{('th', 'ff', 'mf', 'rf', 'lf')[finger % 5]}distal"


@pytest.mark.parametrize("hand", ["shadow", "allegro", "allegro-narrow", "arm-allegro"])
def test_fingertips_are_drawn_where_they_touch(hand):
    scene = build_scene(SceneConfig(hand=hand, primitive_fingertips=True))
    drawn, model = drawing(scene), scene.model
    for number, body in enumerate(scene.hand_bodies):
        shells = [s for s in drawn["shells"] if s["body"] == number and s["finger"] is not None]
        if not shells:
            continue
        capsule = model.body_geomadr[body] + model.body_geomnum[body] - 1  # the tip comes last
        radius, half_length, _ = model.geom_size[capsule]
        along = np.zeros(3)
        mujoco.mju_rotVecQuat(along, np.array([0.0, 0, half_length]), model.geom_quat[capsule])
        ends = (model.geom_pos[capsule] + along)[2], (model.geom_pos[capsule] - along)[2]
        highest = max(z + r for s in shells for _, _, z, r in s["balls"])
        assert highest == pytest.approx(max(ends) + radius, abs=5e-4)


def test_hands_of_a_model_for_drawing_move_as_those_that_play():
    scene = build_scene()
    model = drawn_model(scene)
    assert (model.nq, model.nu) == (scene.model.nq, scene.model.nu)
    ours, theirs = mujoco.MjData(model), mujoco.MjData(scene.model)
    ours.qpos[:] = theirs.qpos[:] = np.random.default_rng(0).normal(size=model.nq)
    mujoco.mj_kinematics(model, ours)
    mujoco.mj_kinematics(scene.model, theirs)
    assert_allclose(ours.xpos[scene.hand_bodies], theirs.xpos[scene.hand_bodies], atol=1e-12)
    assert_allclose(ours.site_xpos, theirs.site_xpos, atol=1e-12)


def test_keys_lie_where_the_simulation_has_them(scene):
    keys, model = drawing(scene)["keys"], scene.model
    assert len(keys) == PIANO.num_keys
    assert sum(key["black"] for key in keys) == 36
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for key, adr in zip(keys, range(model.nq)[scene.key_qpos], strict=True):
        (joint,) = np.flatnonzero(model.jnt_qposadr == adr)
        geom = model.body_geomadr[model.jnt_bodyid[joint]]
        assert_allclose(key["pos"], data.geom_xpos[geom], atol=1e-6)
        assert_allclose(key["size"], model.geom_size[geom], atol=1e-6)
        assert_allclose(key["hinge"], data.xanchor[joint], atol=1e-6)
        assert_allclose(key["axis"], data.xaxis[joint], atol=1e-6)
        assert_allclose(key["travel"], model.jnt_range[joint, 1], atol=1e-6)


def test_poses_are_those_of_mujoco(scene):
    with np.load(EPISODE) as file:
        of_side = [n[:3] in prefixes(scene) for n in file["hand_joint_names"]]
        qpos = file["hand_qpos"][::50, of_side]
    xpos, xquat = body_poses(scene, qpos)
    data = mujoco.MjData(scene.model)
    for t in range(len(qpos)):
        data.qpos[scene.hand_qpos] = qpos[t]
        mujoco.mj_forward(scene.model, data)
        assert_allclose(xpos[t], data.xpos[scene.hand_bodies], rtol=0, atol=1e-6)
        assert_allclose(xquat[t], data.xquat[scene.hand_bodies], rtol=0, atol=1e-6)


def prefixes(scene: Scene) -> tuple[str, ...]:
    return tuple("rh_" if side == "right" else "lh_" for side in scene.sides)


def test_nothing_to_draw_of_hands_that_are_not_there():
    xpos, xquat = body_poses(build_scene(SceneConfig(hands="none")), np.zeros((4, 0)))
    assert xpos.shape == (4, 0, 3)
    assert xquat.shape == (4, 0, 4)


def test_a_link_that_is_called_like_a_key_is_drawn(monkeypatch):
    ball = Geom("sphere", (0.0123,))
    link = Link("low_key_finger", "palm", (0, 0, 0), 0.1, (0, 0, 0), (1e-4,) * 3, geoms=(ball,))
    hand = replace(SHADOW, body=replace(SHADOW.body, links=(*SHADOW.body.links, link)))
    monkeypatch.setattr("cadenza.scene.scene.hand_named", lambda _: hand)
    drawn = drawing(build_scene(SceneConfig(hands="right")))
    body = drawn["bodies"].index("rh_low_key_finger")
    assert [g["size"] for g in drawn["geoms"] if g["body"] == body] == [[0.0123]]


@pytest.mark.parametrize("keyboard", [PIANO, MINI], ids=lambda keyboard: keyboard.name)
def test_keys_go_down_without_touching_the_case(keyboard):
    front = keyboard.centre + keyboard.half_size
    for piece in furniture(keyboard):
        if piece.slope:
            continue
        low, high = (np.array(piece.pos) + sign * np.array(piece.half_size) for sign in (-1, 1))
        beside = (low[1] >= front[:, 1]) | (high[1] <= (keyboard.centre - keyboard.half_size)[:, 1])
        before, below = low[0] >= front[:, 0], high[2] <= keyboard.bounds[0][2]
        behind = high[0] <= keyboard.bounds[0][0] + 0.0025  # where keys turn, and hardly move
        assert (beside | before | below | behind).all()


def test_the_case_is_around_the_whole_keyboard():
    for keyboard in (PIANO, MINI):
        ends = [abs(piece.pos[1]) + piece.half_size[1] for piece in furniture(keyboard)]
        assert keyboard.half_length < max(ends) < keyboard.half_length + 0.06


@pytest.mark.parametrize(
    "options", [{}, {"hand": "allegro", "keyboard": "mini", "hands": "right", "hand_spacing": 0}]
)
def test_what_is_only_drawn_touches_nothing(options):
    scene = build_scene(SceneConfig(**options))
    drawn = drawn_model(scene)
    keys = key_geoms(drawn, scene)
    assert sorted(keys.values()) == list(range(scene.keyboard.num_keys))
    meshes = drawn.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    meshes[list(keys)] = False
    assert not (drawn.geom_contype | drawn.geom_conaffinity)[meshes].any()
    np.testing.assert_allclose(drawn.body_mass, scene.model.body_mass)
