"""A hand from an MJCF: its parts are those of the file, and faults are said in a line."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cadenza import CadenzaError, SceneConfig
from cadenza.agents.planner.hand_measurement import ReachMeasurement
from cadenza.agents.planner.plan.rest_poses import rest_posture
from cadenza.hands.mjcf import HandFile, Measurement, from_mjcf, measurement_of
from cadenza.hands.registry import hand_named
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of
from hands.leap_like import TOML, mjcf, write_to

UPRIGHT = Measurement((0.0, 0.0, 0.2), (1.0, 0.0, 0.0, 0.0))
PALM, TURN = "rh_palm", np.array([[-1.0, 0, 0], [0, 1, 0], [0, 0, 1]])


def in_palm(scene_data: mujoco.MjData, palm: str, point: np.ndarray) -> np.ndarray:
    body = scene_data.body(palm)
    return body.xmat.reshape(3, 3).T @ (point - body.xpos)


@pytest.mark.parametrize("joints", [1, 2])
def test_fingertips_are_where_mujoco_has_those_of_the_file(joints, tmp_path):
    path = write_to(tmp_path)
    if joints == 2:  # of a body, the first of which turns the finger about its length
        twist = '<joint name="twist" axis="0 0 1" range="-1 1"/><joint name="index_1"'
        text = mjcf().replace('<joint name="index_1"', twist)
        text = text.replace("</actuator>", '<position joint="twist" kp="1"/></actuator>')
        (tmp_path / "leap.xml").write_text(text)
    hand = HandFile(path).hand(UPRIGHT)
    scene = build_scene(SceneConfig(), hand)
    file = mujoco.MjModel.from_xml_path(str(tmp_path / "leap.xml"))
    rng = np.random.default_rng(0)
    theirs, ours = mujoco.MjData(file), mujoco.MjData(scene.model)
    for joint in range(file.njnt):
        angle = rng.uniform(*file.jnt_range[joint])
        theirs.joint(joint).qpos = angle
        for side in "rh_", "lh_":
            ours.joint(side + file.joint(joint).name).qpos = angle
    mujoco.mj_kinematics(file, theirs)
    mujoco.mj_kinematics(scene.model, ours)
    for finger in "thumb", "index", "middle", "ring":
        expected = in_palm(theirs, "palm", theirs.site(f"{finger}_tip").xpos)
        for side, mirror in ("rh_", np.eye(3)), ("lh_", TURN):
            tip = in_palm(ours, f"{side}palm", ours.site(f"{side}{finger}tip").xpos)
            np.testing.assert_allclose(mirror @ tip, expected, atol=1e-7)
    np.testing.assert_allclose(
        sum(scene.model.body(f"rh_{file.body(b).name}").mass for b in range(1, file.nbody)),
        file.body_mass.sum(),
    )
    excluded = {excluded for excluded in hand.body.excluded if "index1" in excluded}
    assert excluded == ({("index0", "index1")} if joints == 2 else set())


def test_a_box_is_as_wide_as_it_reaches_to_the_side_of_its_link(tmp_path):
    path, wide, text = write_to(tmp_path), (0.0098, 0.0134, 0.011), mjcf()
    at = text.index('name="index_2"')
    shape = re.compile(r"<geom [^>]*>").search(text, at)
    box = '<geom type="box" size="{} {} {}" pos="0 0 0.011" mass="0.03"/>'.format(*wide)
    path.with_name("leap.xml").write_text(text[: shape.start()] + box + text[shape.end() :])
    finger = HandFile(path).hand(UPRIGHT).fingers[1]
    assert finger.radii[finger.links.index("index2")] == wide[1]


def test_a_joint_that_follows_moves_with_its_leader(tmp_path):
    path = write_to(tmp_path)
    path.write_text(TOML.replace("[fingers]", "follows = {index_3={index_2=-0.5}}\n[fingers]"))
    scene = build_scene(SceneConfig(hands="right"), HandFile(path).hand(UPRIGHT))
    kinematics = Kinematics(scene)
    servos = kinematics.servos
    assert "index_3" not in servos.names
    posture = np.zeros((2, len(servos.names)))
    posture[1, servos.names.index("index_2")] = step = 1e-5
    tips, jacobian = kinematics.fingertips(posture)
    moved = (tips[1] - tips[0]) / step
    np.testing.assert_allclose(jacobian[0][..., servos.names.index("index_2")], moved, atol=1e-5)
    data = mujoco.MjData(scene.model)
    leader, follower = data.joint("rh_index_2"), data.joint("rh_index_3")
    data.actuator("rh_A_index_2").ctrl = 0.4
    mujoco.mj_step(scene.model, data, 200)
    assert leader.qpos[0] == pytest.approx(0.4, abs=0.1)
    assert follower.qpos[0] == pytest.approx(-0.5 * leader.qpos[0], abs=0.02)


def test_a_joint_follows_from_where_an_equality_of_the_file_begins(tmp_path):
    path = write_to(tmp_path)
    coupled = '<equality><joint joint1="index_3" joint2="index_2" polycoef="0.3 0.5 0 0 0"/>'
    path.with_name("leap.xml").write_text(
        mjcf().replace("<actuator>", f"{coupled}</equality><actuator>")
    )
    hand = HandFile(path).hand(UPRIGHT)
    scene, file = build_scene(SceneConfig(hands="right"), hand), mujoco.MjModel.from_xml_path
    theirs, ours = mujoco.MjData(file(str(tmp_path / "leap.xml"))), mujoco.MjData(scene.model)
    theirs.joint("index_2").qpos, theirs.joint("index_3").qpos = 0.4, 0.3 + 0.5 * 0.4
    ours.joint("rh_index_2").qpos, ours.joint("rh_index_3").qpos = 0.4, 0.5 * 0.4
    mujoco.mj_kinematics(theirs.model, theirs)
    mujoco.mj_kinematics(scene.model, ours)
    expected = in_palm(theirs, "palm", theirs.site("index_tip").xpos)
    tip = in_palm(ours, PALM, ours.site("rh_indextip").xpos)
    np.testing.assert_allclose(tip, expected, atol=1e-7)
    joint = next(link.joint for link in hand.body.links if link.name == "index3")
    np.testing.assert_allclose(joint.range, (-0.6, 1.5))


def described(old: str, new: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(TOML.replace(old, new)) and None


def drawn(old: str, new: str) -> Callable[[Path], None]:
    return lambda path: path.with_name("leap.xml").write_text(mjcf().replace(old, new, 1)) and None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (described('"ring_tip"', '"ring"'), "finger ring: no body of leap.xml is named 'ring'"),
        (described('palm = "palm"', 'palm = "palms"'), "named 'palms'; did you mean palm[?]"),
        (described("kp = 2.0", "kp = -1"), "kp -1: give a positive number"),
        (
            described('"ring_tip"', '{ tip = "ring3", radius = 8 }'),
            "finger ring: radius 8: give metres, 0.03 at most",
        ),
        (
            lambda path: (
                described("[fingers]", "follows = {ring_3={ring_2=1.0}}\n[fingers]")(path),
                drawn(
                    'name="ring_3" axis="1 0 0" range="-0.3',
                    'name="ring_3" axis="1 0 0" range="0.3',
                )(path),
            ),
            r"joint ring_3 follows ring_2 to 0, outside its range \(0.3, 1.8\); correct the file",
        ),
        (described('palm = "palm"', 'palm = "hand"'), "palm: no body of leap.xml is named 'hand'"),
        (described("kp = 2.0", "kpp = 2.0"), "Unknown field 'kpp'.*; docs/how-to/hand.md says"),
        (described("kp = 2.0", "kp = two"), "Invalid value.*; docs/how-to/hand.md says"),
        (described('"ring_tip"', '"palm"'), "finger ring has no joint of its own"),
        (described('"leap.xml"', '"other.xml"'), "other.xml"),
        (
            drawn('<position joint="ring_3" kp="1" forcerange="-1.5 1.5"/>', ""),
            "joint ring_3 has no actuator; give it one, or name it in follows or fixed",
        ),
        (
            drawn('axis="1 0 0" range="-0.2 1.9"', 'type="ball"'),
            "joint index_2 is neither a hinge nor a slide",
        ),
        (drawn("<mujoco", "<mujoko"), "MuJoCo cannot read it"),
        (drawn('damping="0.08"', ""), "joint thumb_0 has no damping; give damping"),
        (
            described("[fingers]", "follows = {ring_3={ring_9=1.0}}\n[fingers]"),
            "followers: there is no joint 'ring_9'",
        ),
    ],
)
def test_faults_are_said_in_a_line(tmp_path, change, message):
    path = write_to(tmp_path)
    change(path)
    with pytest.raises(CadenzaError, match=message) as error:
        HandFile(path).hand(UPRIGHT)
    assert "\n" not in str(error.value)


def test_a_hand_is_measured_before_it_plays(tmp_path):
    path = write_to(tmp_path)
    with pytest.raises(CadenzaError, match="not measured yet; run cadenza hand measure"):
        hand_named(str(path))
    measured = {"pos": UPRIGHT.pos, "quat": UPRIGHT.quat, "sha256": HandFile(path).sha256}
    measurement_of(path).write_text(json.dumps(measured))
    assert hand_named(str(path)) is from_mjcf(path)
    path.write_text(TOML + "# changed\n")
    with pytest.raises(CadenzaError, match="changed since; run cadenza hand measure"):
        from_mjcf(path)


def test_servos_that_overshoot_are_told_gains_with_which_they_do_not(tmp_path):
    path = write_to(tmp_path)
    assert not list(ReachMeasurement(HandFile(path).hand(UPRIGHT)).swinging())
    (tmp_path / "leap.xml").write_text(mjcf().replace('mass="0.02"', 'mass="0.5"'))
    (line,) = ReachMeasurement(HandFile(path).hand(UPRIGHT)).swinging()
    match = re.fullmatch(
        r"servos that overshoot .*: \w+ and \d+ more; try kp = (\S+) and damping = (\S+)", line
    )
    path.write_text(TOML.replace("kp = 2.0", f"kp = {match[1]}\ndamping = {match[2]}"))
    again = ReachMeasurement(HandFile(path).hand(UPRIGHT))
    assert not [*again.swinging(), *again.slow()]
    path.write_text(TOML.replace("kp = 2.0", "damping = 1.0"))
    (late,) = ReachMeasurement(HandFile(path).hand(UPRIGHT)).slow()
    assert late == "servos that strike late, by 1000 ms: thumb_0 and 15 more; see damping and kp"


def test_a_joint_follows_another_where_the_length_of_their_tendon_is_fixed(tmp_path):
    path, fixed = write_to(tmp_path), '<equality><tendon tendon1="t"/></equality>'
    motor = '<position joint="ring_3" kp="1" forcerange="-1.5 1.5"/>'
    wrapped = '<joint joint="ring_2" coef="1"/><joint joint="ring_3" coef="-2"/>'
    text = mjcf().replace(motor, "")
    tendon = f'<tendon><fixed name="t">{wrapped}</fixed></tendon>{fixed}</mujoco>'
    (tmp_path / "leap.xml").write_text(text.replace("</mujoco>", tendon))
    (follower,) = HandFile(path).hand(UPRIGHT).body.followers
    assert (follower.joint, follower.leader, follower.ratio) == ("ring_3", "ring_2", 0.5)


@pytest.mark.parametrize("name", ["leap.xml", "leap.urdf"])
def test_a_model_alone_is_no_hand(name):
    with pytest.raises(CadenzaError, match=f"hand '{name}': give a TOML .* docs/how-to/hand.md"):
        hand_named(name)


def left_mjcf() -> str:
    """The mirror image of the hand, with other names, other frames, and a thumb that turns back."""
    text = re.sub(r"(fromto|pos)=\"(-?[\d.]+) ", lambda m: f'{m[1]}="{-float(m[2]):g} ', mjcf())
    text = text.replace('euler="0 0.7 0"', 'euler="0 -0.7 0"').replace('"0 -1 0"', '"0 1 0"')
    text = text.replace('axis="1 0 0" range="-0.6 1.2"', 'axis="-1 0 0" range="-1.2 0.6"')
    text = text.replace('<body name="palm">', '<body name="palm" quat="0.5 0.5 0.5 0.5">')
    return re.sub(r"\b(palm|thumb|index|middle|ring)", r"left_\1", text)


LEFT = TOML + (
    '[left]\nfile = "left.xml"\npalm = "left_palm"\nkp = 2.0\n[left.fingers]\n'
    + "".join(f'{name} = "left_{name}_tip"\n' for name in ("thumb", "index", "middle", "ring"))
)


def write_both(folder: Path, left: str = "", described: str = LEFT) -> Path:
    path = write_to(folder)
    path.write_text(described)
    (folder / "left.xml").write_text(left or left_mjcf())
    return path


def test_a_left_hand_of_a_second_file_plays_as_the_mirror_image(tmp_path):
    two = build_scene(SceneConfig(), HandFile(write_both(tmp_path)).hand(UPRIGHT))
    one = build_scene(SceneConfig(), HandFile(write_to(tmp_path)).hand(UPRIGHT))
    assert two.hand_joint_names == one.hand_joint_names
    assert two.actuator_names == one.actuator_names
    np.testing.assert_allclose(two.model.actuator_ctrlrange, one.model.actuator_ctrlrange)
    np.testing.assert_allclose(two.model.dof_M0, one.model.dof_M0, rtol=1e-6)
    rng, data = np.random.default_rng(0), [mujoco.MjData(each.model) for each in (one, two)]
    low, high = one.model.jnt_range[one.model.dof_jntid[one.hand_qvel]].T
    for _ in range(5):
        posture, tips = rng.uniform(low, high), []
        for scene, each in zip((one, two), data, strict=True):
            each.qpos[scene.hand_qpos] = posture
            mujoco.mj_kinematics(scene.model, each)
            tips.append(each.site_xpos[scene.fingertip_sites].copy())
        np.testing.assert_allclose(*tips, atol=1e-6)


@pytest.mark.parametrize(
    ("left", "description", "message"),
    [
        ("", LEFT.replace('thumb = "left_thumb_tip"\n', ""), "left: fingers: give the same"),
        ("", LEFT.replace('"left_palm"', '"palm"'), "palm: no body of left.xml is named 'palm'"),
        (
            left_mjcf().replace('pos="-0.034 0 0.1"', 'pos="-0.034 0 0.16"'),
            LEFT,
            "left: finger index ends 45 mm from the mirror image",
        ),
        (
            left_mjcf().replace('axis="1 0 0" range="-0.2 1.9"', 'axis="0 1 0" range="0 1"', 1),
            LEFT,
            "left: joint left_index_2 moves another way than index_2",
        ),
        (mjcf(), LEFT.replace("left_", ""), "left: finger thumb ends"),
    ],
)
def test_faults_of_a_second_file_are_said_in_a_line(tmp_path, left, description, message):
    with pytest.raises(CadenzaError, match=message) as error:
        HandFile(write_both(tmp_path, left, description)).hand(UPRIGHT)
    assert "\n" not in str(error.value)


def test_a_hand_on_an_arm_is_at_rest_where_a_forearm_would_bring_it(tmp_path):
    path, tips = write_to(tmp_path), []
    for mount in "forearm", "arm":
        path.write_text(f'mount = "{mount}"\n{TOML}')
        measured = {"pos": UPRIGHT.pos, "quat": (0.98, 0.2, 0, 0), "sha256": HandFile(path).sha256}
        measurement_of(path).write_text(json.dumps(measured))
        scene = build_scene(SceneConfig(), from_mjcf(path))
        tips.append(Kinematics(scene).fingertips(rest_posture(servos_of(scene))[None])[0][0])
    forearm, arm = tips
    apart = [[0, 0.05, 0]] * 4 + [[0, -0.05, 0]] * 4  # arms stand farther apart
    np.testing.assert_allclose(arm - forearm, apart, atol=1e-4)


def test_a_left_hand_of_its_own_hangs_on_no_arm(tmp_path):
    path = write_both(tmp_path, described=f'mount = "arm"\n{LEFT}')
    with pytest.raises(CadenzaError, match="left: a hand on an arm is mirrored; leave it out"):
        HandFile(path)
