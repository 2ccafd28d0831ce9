"""Fingers and servos of a scene against MuJoCo's own figures of the whole scene."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from threadpoolctl import threadpool_limits

from cadenza.hands.body import prefix
from cadenza.scene.config import SceneConfig
from cadenza.scene.kinematics import TIP, Kinematics
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import Reaction, Servos, servos_of

CONFIGS = [SceneConfig(), SceneConfig(hands="left"), SceneConfig(reduced_action_space=False)]


@pytest.mark.parametrize("config", CONFIGS, ids=["both", "left", "full"])
def test_fingertips_and_their_jacobian_are_mujocos(config):
    scene = build_scene(config)
    servos = servos_of(scene)
    postures = np.random.default_rng(0).uniform(servos.low, servos.high, (5, len(servos.low)))
    kinematics = Kinematics(scene)
    fingertips = kinematics.fingertips(postures)
    model, data = scene.model, mujoco.MjData(scene.model)
    for posture, tips, slope in zip(postures, *fingertips, strict=True):
        data.qpos[scene.hand_qpos] = posture @ servos.joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        np.testing.assert_allclose(tips, data.site_xpos[scene.fingertip_sites], atol=1e-12)
        for i, (site, own) in enumerate(zip(scene.fingertip_sites, slope, strict=True)):
            of_joints = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, of_joints, None, site)
            expected = of_joints[:, scene.hand_qvel] @ servos.joints.T
            here = np.zeros_like(expected)
            here[:, scene.servos_on(scene.sides[i // len(scene.hand.fingers)])] = own
            np.testing.assert_allclose(here, expected, atol=1e-12)


@pytest.mark.parametrize(
    "config",
    [*CONFIGS, SceneConfig(hand="allegro"), SceneConfig(hand="arm-allegro")],
    ids=["both", "left", "full", "allegro", "arm"],
)
def test_points_on_links_move_as_in_mujoco(config):
    scene = build_scene(config)
    servos, rng = servos_of(scene), np.random.default_rng(2)
    kinematics = Kinematics(scene)
    postures = rng.uniform(servos.low, servos.high, (5, len(servos.low)))
    points, links = kinematics.points(postures), kinematics.links(postures)
    np.testing.assert_array_equal(links.points.reshape(points.shape), points)
    tips, jacobian = kinematics.fingertips(postures)
    np.testing.assert_array_equal(tips, points[:, :, TIP])
    np.testing.assert_array_equal(links.tips.reshape(jacobian.shape), jacobian)

    ends = (5, points.shape[1], points.shape[2] - 1)
    posture, finger, link = rng.integers(ends, size=(99, 3)).T
    share, direction = rng.uniform(size=(99, 1)), rng.standard_normal((99, 3))
    begin, end = points[posture, finger, link], points[posture, finger, link + 1]
    at = begin + share * (end - begin)
    along = links.along(posture, finger, link, at, direction)
    model, data = scene.model, mujoco.MjData(scene.model)
    for i, forces in enumerate(along):
        side, own = divmod(int(finger[i]), len(scene.hand.fingers))
        body = prefix(scene.sides[side]) + scene.hand.fingers[own].links[link[i]]
        data.qpos[scene.hand_qpos] = postures[posture[i]] @ servos.joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        of_joints = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, of_joints, None, at[i], model.body(body).id)
        expected = direction[i] @ of_joints[:, scene.hand_qvel] @ servos.joints.T
        ours = scene.servos_on(scene.sides[side])
        np.testing.assert_allclose(forces, expected[ours], atol=1e-12)


def test_links_are_where_their_bodies_are():
    scene = build_scene(SceneConfig(hands="right"))
    servos = servos_of(scene)
    posture = np.random.default_rng(1).uniform(servos.low, servos.high)
    (points,) = Kinematics(scene).points(posture[None])
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = posture @ servos.joints
    mujoco.mj_kinematics(scene.model, data)
    for finger, links in {0: ("thproximal", "thmiddle"), 4: ("lfproximal", "lfmiddle")}.items():
        for link, name in enumerate(links):
            np.testing.assert_allclose(
                points[finger, link], data.body(f"rh_{name}").xpos, atol=1e-12
            )


def test_servos_hold_what_the_model_says():
    scene = build_scene()
    servos = servos_of(scene)
    by_name = dict(zip(servos.names, servos.stiffness, strict=True))
    assert (by_name["WRJ2"], by_name["FFJ0"], by_name["forearm_tx"]) == (10.0, 0.5, 300.0)
    # A control held for long is where the servos end up, the coupled joints sharing it.
    data = mujoco.MjData(scene.model)
    data.ctrl = np.clip(0.3, servos.low, servos.high) * 0.9
    mujoco.mj_step(scene.model, data, 600)
    reached = np.linalg.pinv(servos.joints).T @ data.qpos[scene.hand_qpos]
    off = np.abs(reached - data.ctrl)
    assert np.median(off) < 0.02


@pytest.mark.parametrize("moving", ["forearm_tx", "FFJ0", "all"])
def test_reaction_is_what_inverse_dynamics_say(moving):
    """A forearm that speeds up pushes its hand: what that asks of the fingers' servos."""
    scene = build_scene(SceneConfig(hands="right"))
    scene.model.opt.gravity[:] = 0.0  # which the model compensates otherwise
    servos = servos_of(scene)
    dt, change = 0.05, np.array([0.02 * (moving in (name, "all")) for name in servos.names])
    postures = change / 2 * np.arange(5.0)[:, None] ** 2
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = postures[2] @ servos.joints
    data.qvel[scene.hand_qvel] = (postures[3] - postures[1]) @ servos.joints / (2 * dt)
    data.qacc[scene.hand_qvel] = change / dt**2 @ servos.joints
    mujoco.mj_inverse(scene.model, data)
    needed = data.qfrc_inverse + data.qfrc_passive + data.qfrc_constraint
    expected = needed[scene.hand_qvel] @ servos.joints.T - servos.inertia * change / dt**2
    forces = Reaction(scene, servos).along(postures, dt)[2]
    np.testing.assert_allclose(forces, expected, atol=1e-9)


def test_coordinates_of_joints_do_not_depend_on_the_threads_of_linear_algebra():
    servos = servos_of(build_scene(SceneConfig(reduced_action_space=False)))
    maps = []
    for threads in (1, 2):
        with threadpool_limits(threads):
            fresh = Servos(**{name: getattr(servos, name) for name in servos.__dataclass_fields__})
            maps.append(fresh.of_joints)
    assert_array_equal(*maps)
