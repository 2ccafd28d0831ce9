"""Rollouts are what happens in the whole scene, whatever is left out of their models."""

import weakref
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from cadenza.agents.playback import load_plan
from cadenza.fingers import Side
from cadenza.scene.config import SceneConfig
from cadenza.scene.scene import build_scene, colliding_parts, hand_alone, reduced_model
from cadenza.scene.servos import servos_of
from cadenza.sim import hand_rollouts
from cadenza.sim.hand_rollouts import HandRollouts
from cadenza.sim.planning_simulation import PlanningSimulation

RECORDED = Path(__file__).parents[1] / "data" / "episode_d.npz"
AHEAD = 7  # steps


class Alone:
    """A hand alone, and rollouts on the keys in the middle from where it is."""

    def __init__(self, side: Side = "right") -> None:
        self.scene, self.servos, _ = hand_alone(build_scene(), side)
        self.simulation = PlanningSimulation(self.scene)
        self.rollouts = HandRollouts(self.scene, self.simulation.control_timestep)
        self.start()

    def start(self, low: int = 30, high: int = 50) -> None:
        y = self.scene.keyboard.centre[:, 1]
        self.rollouts.start_from(self.simulation, y[low], y[high])

    @property
    def recorded(self) -> np.ndarray:
        """(7, A) what it did in a performance."""
        return load_plan(RECORDED).actions[40:47, :-1][:, self.servos]


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_hand_on_the_keys_near_it_moves_as_on_all(side):
    scene, servos, _ = hand_alone(build_scene(), side)
    actions = load_plan(RECORDED).actions[:, :-1][:, servos]
    simulation, there = PlanningSimulation(scene), PlanningSimulation(scene)
    rollouts = HandRollouts(scene, simulation.control_timestep)
    fingers = scene.present_fingers
    touched = False
    for step in range(len(actions) - AHEAD):
        if step % 5 == 0:
            there.copy_from(simulation, 0)
            y = simulation.state.fingertip_xpos[0, fingers, 1]
            rollouts.start_from(simulation, y.min(), y.max())
            assert rollouts.keys.stop - rollouts.keys.start < 40
            ahead = actions[step : step + AHEAD]
            for (key_path, fingertips), ctrl in zip(rollouts.run(ahead), ahead, strict=True):
                key_qpos = key_path[-1]
                there.step(ctrl[None])
                expected = there.state.key_qpos[0, rollouts.keys]
                np.testing.assert_allclose(key_qpos, expected, atol=1e-3)
                tips = there.state.fingertip_xpos[0, fingers]
                np.testing.assert_allclose(fingertips, tips, atol=1e-3)
                touched |= bool((key_qpos > 0.5 * scene.keyboard.travel[rollouts.keys]).any())
            assert not rollouts.unstable()
            np.testing.assert_array_equal(rollouts.fingertips(), fingertips)
        simulation.step(actions[step][None])
    assert touched


def test_key_paths_are_the_angles_after_each_physics_step(monkeypatch):
    hand = Alone()
    actions, rollouts = hand.recorded, hand.rollouts
    start = hand.scene.hand_start
    hand.simulation.set_joints(start, np.zeros_like(start), np.zeros(88))
    hand.start()
    paths = [path for path, _ in rollouts.run(actions)]
    followed: list[np.ndarray] = []

    def stop_after_each(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> None:
        for _ in range(count):
            followed.append(data.qpos[: paths[0].shape[1]].copy())
            step(model, data)

    step = mujoco.mj_step
    monkeypatch.setattr(mujoco, "mj_step", stop_after_each)
    again = [path for path, _ in rollouts.run(actions)]
    np.testing.assert_array_equal(again, paths)
    np.testing.assert_array_equal(np.array(paths)[:, :-1], np.reshape(followed, (7, 10, -1)))
    np.testing.assert_array_equal(np.array(paths)[1:, 0], np.array(paths)[:-1, -1])
    assert np.ptp(paths, axis=(0, 1)).max() > 0.01  # a key moves


def test_a_rollout_continues_from_a_state_that_another_has_saved():
    hand, snapshots = Alone(), [2, 5]
    actions, rollouts = hand.recorded, hand.rollouts
    paths = [path for path, _ in rollouts.run(actions, snapshots=snapshots)]
    list(rollouts.run(actions[:1]))  # of something else
    for first in (2, 5):
        rest = [path for path, _ in rollouts.run(actions[first:], first, snapshots)]
        np.testing.assert_array_equal(rest, paths[first:])


def test_fingertips_move_with_servos_as_the_jacobian_says():
    hand = Alone("left")
    scene, moved = hand.scene, PlanningSimulation(hand.scene)
    rng = np.random.default_rng(0)
    low, high = scene.model.jnt_range[scene.model.dof_jntid[scene.hand_qvel]].T
    posture = rng.uniform(0.8 * low + 0.2 * high, 0.2 * low + 0.8 * high)
    (jacobian,) = hand.rollouts.fingertip_jacobian(posture[None])
    servos = servos_of(scene)
    change = 1e-6 * rng.standard_normal(len(servos.low))
    step = servos.joints.T @ change
    for simulated, qpos in ((hand.simulation, posture), (moved, posture + step)):
        simulated.set_joints(qpos, np.zeros_like(qpos), np.zeros(88))
    before, after = (
        each.state.fingertip_xpos[0, scene.present_fingers] for each in (hand.simulation, moved)
    )
    np.testing.assert_allclose(jacobian @ change, after - before, atol=1e-10)


@pytest.mark.parametrize("hand", ["shadow", "allegro"])
def test_a_reduced_model_keeps_joints_servos_and_weight(hand):
    scene = build_scene(SceneConfig(hands="left", hand=hand))
    model, some = scene.model, reduced_model(scene, range(30, 50), colliding_parts(scene))
    joints = [some.joint(j).name for j in range(some.njnt)]
    assert joints == [
        name
        for name in (model.joint(j).name for j in range(model.njnt))
        if "key" not in name or 30 <= int(name.rsplit("_", 1)[1]) < 50
    ]
    assert [some.actuator(a).name for a in range(some.nu)] == list(scene.actuator_names)
    body = mujoco.mjtObj.mjOBJ_BODY
    names = [mujoco.mj_id2name(some, body, b) for b in range(1, some.nbody)]
    same = [mujoco.mj_name2id(model, body, name) for name in names]
    np.testing.assert_allclose(some.body_mass[1:], model.body_mass[same])
    np.testing.assert_allclose(some.body_inertia[1:], model.body_inertia[same])
    kept = [model.joint(name).dofadr[0] for name in joints]
    np.testing.assert_allclose(some.dof_damping, model.dof_damping[kept], rtol=1e-12)
    assert some.ngeom < 0.5 * model.ngeom


def test_models_are_few_however_far_a_hand_goes_and_the_same_when_made_again(monkeypatch):
    alive = weakref.WeakSet[mujoco.MjModel]()

    def recorded(*args: Any) -> mujoco.MjModel:
        alive.add(model := reduced_model(*args))
        return model

    monkeypatch.setattr(hand_rollouts, "reduced_model", recorded)
    hand = Alone()
    actions = np.zeros((AHEAD, hand.scene.model.nu))

    def tried() -> list[np.ndarray]:
        hand.start()
        return [fingertips.copy() for _, fingertips in hand.rollouts.run(actions)]

    before = tried()
    for low in range(0, 84, 6):
        for high in range(low + 6, 88, 24):
            hand.start(low, high)
    assert 1 < len(alive) <= 16
    np.testing.assert_array_equal(tried(), before)
