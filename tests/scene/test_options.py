"""Every option of the scene against what the published system computes with it."""

import json
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.keyboards.piano import PIANO
from cadenza.music.libraries.library import load_score
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.reward import key_activation

PUBLISHED = json.loads((Path(__file__).parents[1] / "data/published_options.json").read_text())
ALL_DOFS: Any = ("tx", "ty", "tz", "roll", "pitch", "yaw")
SIDES = {"right": "rh_", "left": "lh_"}
CLOSE = {"rtol": 1e-6, "atol": 1e-9}

ROLLOUTS = {
    "default": SceneConfig(),
    "all_forearm_dofs": SceneConfig(forearm_dofs=ALL_DOFS),
    "all_forearm_dofs_full_actions": SceneConfig(forearm_dofs=ALL_DOFS, reduced_action_space=False),
    "yaw_15": SceneConfig(attachment_yaw=15.0),
    "no_gravity_compensation": SceneConfig(gravity_compensation=False),
    "disable_hand_collisions": SceneConfig(hand_collisions=False),
    "left_hand_only": SceneConfig(hands="left"),
    "right_hand_only": SceneConfig(hands="right"),
}


def test_every_published_rollout_is_run():
    assert ROLLOUTS.keys() == PUBLISHED["rollouts"]["cases"].keys()


@pytest.mark.parametrize("case", ROLLOUTS)
def test_moves_as_published(case):
    """Until the forearms touch, whose shells are a mesh there and a cylinder here."""
    scene = build_scene(ROLLOUTS[case])
    simulation = MujocoSimulation(scene, watch_forearms=True)
    recorded = {step["step"]: step for step in PUBLISHED["rollouts"]["cases"][case]}
    touched = False
    for step in range(1, max(recorded) + 1):
        simulation.step(smooth_action(scene, step)[None, :-1])
        state = simulation.state
        touched |= bool(state.forearm_contact[0])
        if step in recorded:
            tips = state.fingertip_xpos[0, scene.present_fingers]
            tolerance = {"rtol": 0, "atol": 0.02 if touched else 2e-6}
            assert_allclose(tips, recorded[step]["fingertip_xpos"], **tolerance)
            if not touched:
                joints = state.hand_qpos[0, in_published_order(scene)]
                assert_allclose(joints, recorded[step]["hand_qpos"], **tolerance)


def smooth_action(scene: Scene, step: int) -> np.ndarray:
    """The action of the recorded rollouts, in actuator units, the pedal last."""
    low, high = scene.action_low, scene.action_high
    return (low + high) / 2 + 0.25 * (high - low) / 2 * np.sin(0.7 * step + np.arange(len(low)))


def in_published_order(scene: Scene) -> list[int]:
    """The published observation has a hand's forearm after its fingers, ours as in the model."""
    names = scene.hand_joint_names
    return sorted(range(len(names)), key=lambda j: (names[j][:3] == "lh_", "forearm" in names[j]))


@pytest.mark.parametrize("side", SIDES)
def test_forearm_joints(side):
    model = build_scene(SceneConfig(forearm_dofs=ALL_DOFS)).model
    for figure in PUBLISHED["forearm_dofs"][side]:
        joint = model.joint(SIDES[side] + figure["name"])
        dof = joint.dofadr[0]
        slides = joint.type[0] == mujoco.mjtJoint.mjJNT_SLIDE
        assert slides == (figure["type"] == "slide")
        for name in ("axis", "pos", "range"):
            assert_allclose(getattr(joint, name), figure[name], err_msg=name, **CLOSE)
        for name in ("damping", "armature", "frictionloss"):
            assert_allclose(getattr(model, f"dof_{name}")[dof], figure[name], rtol=1e-6)
        assert_allclose(joint.stiffness[0], figure["stiffness"])
        assert_allclose(model.dof_M0[dof], figure["inertia_at_rest"], rtol=1e-6)
        servo = model.actuator(f"{SIDES[side]}A_{figure['name']}")
        assert_allclose(servo.gainprm[0], figure["gain"])
        assert_allclose(servo.biasprm[:3], figure["bias"])
        assert_allclose(servo.ctrlrange, figure["ctrlrange"], **CLOSE)
        assert bool(servo.forcelimited[0]) == (figure["forcerange"] is not None)


@pytest.mark.parametrize("reduced", [True, False])
def test_order_of_joints_and_actuators(reduced):
    scene = build_scene(SceneConfig(forearm_dofs=ALL_DOFS, reduced_action_space=reduced))
    order = PUBLISHED["order_with_all_forearm_dofs"]["reduced" if reduced else "full"]
    joints = [p + name for p in SIDES.values() for name in order["joints"]]
    actuators = [
        p + name.replace("forearm", "A_forearm")
        for p in SIDES.values()
        for name in order["actuators"]
    ]
    assert list(scene.hand_joint_names) == joints
    assert list(scene.actuator_names) == actuators


def test_chosen_forearm_joints_come_in_the_order_asked_for():
    scene = build_scene(SceneConfig(hands="right", forearm_dofs=("yaw", "tx")))
    assert scene.hand_joint_names[:2] == ("rh_forearm_yaw", "rh_forearm_tx")
    fixed = build_scene(SceneConfig(forearm_dofs=()))
    assert not [n for n in (*fixed.hand_joint_names, *fixed.actuator_names) if "forearm" in n]


@pytest.mark.parametrize("yaw", ["0", "15", "-30"])
@pytest.mark.parametrize("side", SIDES)
def test_mounting(side, yaw):
    figure = PUBLISHED["mounting"][side]
    model = build_scene(SceneConfig(attachment_yaw=float(yaw))).model
    forearm = model.body(f"{SIDES[side]}forearm")
    assert_allclose(forearm.pos, figure["pos"])
    quat = np.array(figure["quat_at_yaw_degrees"][yaw])
    assert_allclose(abs(forearm.quat @ quat) / np.linalg.norm(quat), 1.0, atol=1e-9)


@pytest.mark.parametrize("spacing", [0.1, 0.3, 0.6])
def test_both_hands_reach_the_whole_keyboard_at_any_spacing(spacing):
    model = build_scene(SceneConfig(hand_spacing=spacing)).model
    data = mujoco.MjData(model)
    for prefix, sign in (("rh_", 1), ("lh_", -1)):
        forearm, slide = model.body(f"{prefix}forearm"), model.joint(f"{prefix}forearm_tx")
        assert_allclose(forearm.pos[1], sign * spacing / 2)
        for end, keyboard_end in zip(slide.range, (-0.6105, 0.6105), strict=True):
            data.qpos[slide.qposadr] = end
            mujoco.mj_kinematics(model, data)
            assert_allclose(data.xpos[forearm.id, 1], keyboard_end)


@pytest.mark.parametrize("compensated", [True, False])
def test_gravity_compensation(compensated):
    figures = PUBLISHED["gravity_compensation"]
    scene = build_scene(SceneConfig(gravity_compensation=compensated))
    model, value = scene.model, figures["gravcomp_on" if compensated else "gravcomp_off"]
    bodies = {model.body(f"{p}{name}").id for p in SIDES.values() for name in figures["bodies"]}
    assert bodies == set(scene.hand_bodies.tolist())
    assert (model.body_gravcomp[scene.hand_bodies] == value).all()
    assert not np.delete(model.body_gravcomp, scene.hand_bodies).any()


@pytest.mark.parametrize("collide", [True, False])
def test_hand_collisions(collide):
    figures = PUBLISHED["disable_hand_collisions"]
    scene = build_scene(SceneConfig(hand_collisions=collide))
    model = scene.model
    of_hands = np.isin(model.geom_bodyid, scene.hand_bodies)
    colliding = (model.geom_contype > 0) | (model.geom_conaffinity > 0)
    pairs = np.stack([model.geom_contype, model.geom_conaffinity], axis=1)
    ours = pairs[of_hands & colliding]
    expected = figures["default" if collide else "hand_geoms_contype_conaffinity"]
    assert len(ours) == 2 * figures["colliding_geoms_per_hand"]
    assert (ours == expected).all()
    assert (pairs[~of_hands] == figures["piano_geoms"]).all()


@pytest.mark.parametrize("hands", ["both", "right", "left"])
def test_fast_physics_changes_what_it_says(hands):
    """Longer steps, no dry friction, and nothing else."""
    published = build_scene(SceneConfig(hands=hands)).model
    fast = build_scene(SceneConfig(hands=hands, physics="fast")).model
    assert fast.opt.timestep == 2 * published.opt.timestep
    assert published.dof_frictionloss.any()
    assert not fast.dof_frictionloss.any()
    for name in ("body_mass", "geom_size", "geom_pos", "geom_contype", "geom_conaffinity",
                 "geom_solref", "jnt_range", "dof_damping",
                 "actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):  # fmt: skip
        assert_array_equal(getattr(fast, name), getattr(published, name), err_msg=name)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("finger", ["th", "ff", "mf", "rf", "lf"])
@pytest.mark.parametrize("primitive", [True, False])
def test_fingertips(side, finger, primitive):
    """A capsule as published, or an ellipsoid with the bounds of the published mesh."""
    figure = PUBLISHED["fingertip_collisions"]["thumb" if finger == "th" else "fingers"]
    scene = build_scene(SceneConfig(primitive_fingertips=primitive))
    model = scene.model
    (g,) = np.flatnonzero(model.geom_bodyid == model.body(f"{SIDES[side]}{finger}distal").id)
    if primitive:
        capsule = figure["capsule"]
        assert model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CAPSULE
        assert_allclose(model.geom_pos[g], capsule["pos"], rtol=1e-6, atol=2e-9)
        assert_allclose(model.geom_size[g, :2], [capsule["radius"], capsule["half_length"]], 1e-6)
    else:
        mesh = figure["mesh"]
        rotation = np.zeros(9)
        mujoco.mju_quat2Mat(rotation, model.geom_quat[g])
        size = model.geom_size[g]
        half = np.sqrt(rotation.reshape(3, 3) ** 2 @ size**2)  # of a turned ellipsoid
        assert model.geom_type[g] == mujoco.mjtGeom.mjGEOM_ELLIPSOID
        assert_allclose(model.geom_pos[g], mesh["aabb_center"], atol=1e-6)
        assert_allclose(half, mesh["aabb_half_size"], atol=1e-6)
        assert 0.75 < 4 / 3 * np.pi * size.prod() / mesh["convex_volume"] < 1.0
    for name in ("contype", "conaffinity", "condim", "friction", "solref", "solimp", "margin"):
        assert_allclose(getattr(model, f"geom_{name}")[g], figure[name], err_msg=name)


@pytest.mark.parametrize("side", SIDES)
def test_one_hand_is_the_same_hand(side):
    both, alone = build_scene(), build_scene(SceneConfig(hands=side))
    prefix = SIDES[side]
    assert alone.sides == (side,)
    assert alone.actuator_names == tuple(n for n in both.actuator_names if n.startswith(prefix))
    assert alone.hand_joint_names == tuple(n for n in both.hand_joint_names if n.startswith(prefix))
    assert alone.present_fingers == (slice(0, 5) if side == "right" else slice(5, 10))
    assert_array_equal(alone.action_low[:-1], both_rows(both, prefix, both.action_low))
    assert_array_equal(alone.action_high[:-1], both_rows(both, prefix, both.action_high))


def both_rows(scene: Scene, prefix: str, values: np.ndarray) -> np.ndarray:
    return values[:-1][[name.startswith(prefix) for name in scene.actuator_names]]


def sounding(simulation: MujocoSimulation) -> np.ndarray:
    """(K,) of the first environment."""
    keyboard = simulation.scene.keyboard
    return key_activation(simulation.state.key_qpos[0], keyboard.sounds_from)


class TestPianoThatPlaysItself:
    """Deliberately not as published: there a key's control, not its angle, makes it sound."""

    @pytest.fixture(params=["published", "fast"])
    def scene(self, request):
        return build_scene(SceneConfig(hands="none", physics=request.param))

    def test_actions(self, scene):
        figures = PUBLISHED["self_actuated_piano"]
        assert scene.model.nu == figures["actuators"] == PIANO.num_keys
        assert len(scene.action_low) == figures["action_size"]
        assert (scene.action_low == figures["action_min"]).all()
        assert_allclose(
            scene.action_high[:2], [figures["white_ctrlrange"][1], figures["black_ctrlrange"][1]]
        )
        assert scene.action_high[-1] == figures["pedal_max"]
        assert_allclose(scene.action_high[:-1], PIANO.travel)

    @pytest.mark.parametrize("key", [0, 1, 43, 46, 87])
    def test_a_key_sounds_while_it_is_held_and_no_other(self, scene, key):
        simulation = MujocoSimulation(scene)
        ctrl = np.zeros((1, PIANO.num_keys))
        for _ in range(2):
            ctrl[0, key] = PIANO.travel[key]
            for _ in range(3):
                simulation.step(ctrl)
                assert np.flatnonzero(sounding(simulation)).tolist() == [key]
            ctrl[0, key] = 0.0
            for _ in range(3):
                simulation.step(ctrl)
                assert not sounding(simulation).any()
        assert abs(simulation.state.key_qpos).max() < 0.1 * PIANO.travel[0]

    def test_all_keys_follow_at_once(self, scene):
        simulation, key = MujocoSimulation(scene), np.arange(PIANO.num_keys)
        for step in range(12):
            down = (key + step) % 3 == 0
            simulation.step(np.where(down, PIANO.travel, 0.0)[None])
            assert_array_equal(sounding(simulation), down)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hands": "three"}, "hands 'three': choose from both, apart, right, left, none"),
        ({"physics": "magic"}, "physics 'magic': choose from published, fast"),
        ({"forearm_dofs": ("tx", "tx")}, "at most once"),
        (
            {"forearm_dofs": ("sideways",)},
            "for each of it, choose from tx, ty, tz, roll, pitch, yaw",
        ),
        ({"hand_spacing": -0.1}, "hand_spacing -0.1 m"),
        ({"hand_spacing": float("nan")}, "hand_spacing nan m"),
        ({"attachment_yaw": 360.0}, "attachment_yaw 360.0 degrees: choose -180 to 180"),
        ({"attachment_yaw": float("inf")}, "attachment_yaw inf degrees"),
    ],
)
def test_says_what_is_wrong(options, message):
    with pytest.raises(CadenzaError, match=message) as error:
        build_scene(SceneConfig(**options))
    assert "\n" not in str(error.value)


def test_creating_an_environment_takes_under_half_a_second():
    score = load_score("TwinkleTwinkleLittleStar")
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        PianoTask([score]).reset([np.random.default_rng(0)], [0])
        seconds.append(time.perf_counter() - started)
    assert min(seconds) < 0.5
