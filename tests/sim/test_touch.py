"""Touch sensors on the fingertips, against the contact forces that MuJoCo computes."""

from functools import cache
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.protocol import State

HANDS: dict[str, dict[str, Any]] = {
    "allegro": {"keyboard": "mini", "hand": "allegro", "hands": "right", "hand_spacing": 0.0},
    "shadow": {"hands": "left"},
}
STEPS = 40


@cache
def scene_of(hand: str, touch: bool = True) -> Scene:
    return build_scene(SceneConfig(touch=touch, **HANDS[hand]))


def controls(scene: Scene) -> np.ndarray:
    """(STEPS, A) fingers around their posture over the keys, into which they are pressed."""
    low, high = scene.action_low[:-1], scene.action_high[:-1]
    names = [name.split("_A_")[1] for name in scene.actuator_names]
    rest = np.array([scene.hand.servo(name).rest for name in names])
    off = np.random.default_rng(1).uniform(-0.1, 0.3, (STEPS // 8, len(rest)))
    return np.clip(rest + np.repeat(off, 8, axis=0), low, high)


def played(scene: Scene) -> list[State]:
    simulation = MujocoSimulation(scene)
    simulation.reset(None, scene.hand_start[None])
    states = []
    for ctrl in controls(scene):
        simulation.step(ctrl[None])
        states.append(simulation.state)
    return states


def contact_forces(scene: Scene) -> np.ndarray:
    """(STEPS, fingers) normal forces of the last physics step of each control step on the tips.

    A contact of its link counts within a sphere, a little larger than the tip, and behind it.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = scene.hand_start
    mujoco.mj_step1(model, data)
    forces, force = np.zeros((STEPS, len(scene.fingertip_sites))), np.zeros(6)
    radii = [finger.tip_radius for finger in scene.hand.fingers]
    for step, ctrl in enumerate(controls(scene)):
        data.ctrl = ctrl
        for _ in range(round(0.05 / model.opt.timestep)):
            mujoco.mj_step1(model, data)
            mujoco.mj_step2(model, data)
        for i, contact in enumerate(data.contact):
            mujoco.mj_contactForce(model, data, i, force)
            bodies = model.geom_bodyid[contact.geom].tolist()
            for finger, site in enumerate(scene.fingertip_sites):
                if (body := model.site_bodyid[site]) in bodies:
                    outwards = contact.frame[:3] * (1 if bodies[0] == body else -1)
                    to_centre = data.site_xpos[site] - contact.pos
                    along, reach = to_centre @ outwards, 1.1 * radii[finger]
                    aside = np.linalg.norm(to_centre - along * outwards)
                    if np.linalg.norm(to_centre) < reach or (aside < reach and along > 0):
                        forces[step, finger] += force[0]
    return forces


@pytest.mark.parametrize("hand", HANDS)
def test_they_measure_the_normal_forces_on_the_tips(hand):
    scene = scene_of(hand)
    touch = np.array([state.touch[0] for state in played(scene)])
    expected = contact_forces(scene)
    assert (expected.max(axis=0) > 0.5).sum() >= 3
    assert_allclose(touch[:, scene.present_fingers], expected, rtol=1e-9, atol=1e-9)
    elsewhere = np.delete(touch, np.r_[scene.present_fingers], axis=1)
    assert not elsewhere.any()


@pytest.mark.parametrize("hand", HANDS)
def test_they_change_nothing_else(hand):
    with_them, without = (played(scene_of(hand, touch)) for touch in (True, False))
    for one, other in zip(with_them, without, strict=True):
        assert not other.touch.any()
        for name, values in one._asdict().items():
            if name != "touch":
                assert_array_equal(values, getattr(other, name))


def test_there_are_none_unless_asked_for():
    assert build_scene().model.nsensor == 0
    assert build_scene(SceneConfig(touch=True)).model.nsensor == 10
    assert build_scene(SceneConfig(touch=True, hands="none")).model.nsensor == 0
