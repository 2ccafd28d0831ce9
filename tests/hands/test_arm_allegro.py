"""The arm: its figures, and that nothing it does is beyond them."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

from cadenza.agents.planner.config import ICPConfig
from cadenza.agents.planner.plan.rest_poses import RestPoses, rest_posture
from cadenza.agents.registry import make_agent
from cadenza.episode import load_episode
from cadenza.files import read_json
from cadenza.hands.arm_allegro import ARM_ALLEGRO
from cadenza.hands.body import prefix
from cadenza.music.score import Note, Score
from cadenza.performing.performance import Performance, hand_episodes, play
from cadenza.scene.config import SceneConfig
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import build_scene
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import TaskConfig

ARM = [f"armJ{number}" for number in range(1, 8)]
# iiwa7_allegro.urdf of differentiable-robot-model 0.2.3: limits of the position [rad], velocity
# [rad/s] and torque [N m], and masses [kg].
SPEED, TORQUE = 10.0, 300.0
_FULL, _HALF = 2.9670597283903604, 2.0943951023931953
LIMITS = (_FULL, _HALF, _FULL, _HALF, _FULL, _HALF, 3.0543261909900763)
MASSES = (5.0, 3.4525, 3.4821, 4.05623, 3.4822, 2.1633, 2.3466, 3.129)
LINKS = ("arm0", "arm1", "arm2", "arm3", "arm4", "arm5", "arm6", "forearm")
MELODY = Score(
    tuple(
        Note(0.5 * i, 0.5 * i + 0.45, pitch)
        for i, pitch in enumerate((72, 74, 76, 79, 76, 74, 72, 67))
    ),
    title="Melody",
)
DUET = Score(
    tuple(Note(0.5 * i, 0.5 * i + 0.4, p) for i, p in enumerate((76, 74, 72, 76)))
    + tuple(Note(1.0 * i, 1.0 * i + 0.8, p) for i, p in enumerate((48, 52))),
    title="Duet",
)


@pytest.fixture(scope="module")
def scene():
    return build_scene(SceneConfig(hand="arm-allegro"))


@pytest.mark.parametrize("side", ["right", "left"])
def test_figures_are_those_of_the_urdf(scene, side):
    model, p = scene.model, prefix(side)  # type: ignore[arg-type]
    for name, limit in zip(ARM, LIMITS, strict=True):
        joint = model.joint(p + name)
        np.testing.assert_allclose(joint.range, (-limit, limit))
        np.testing.assert_allclose(model.actuator(f"{p}A_{name}").forcerange, (-TORQUE, TORQUE))
    np.testing.assert_allclose([model.body(p + name).mass[0] for name in LINKS], MASSES)


def test_the_arm_stretched_up_is_as_long_as_in_the_urdf(scene):
    """All joints at 0: 0.15 + 0.19 + 0.21 + 0.19 + 0.21 + 0.19 + 0.081, and 0.145 to the palm."""
    data = mujoco.MjData(scene.model)
    mujoco.mj_kinematics(scene.model, data)
    mount = np.array(ARM_ALLEGRO.body.mount.pos)  # type: ignore[union-attr]
    palm = data.body("rh_palm").xpos - mount
    np.testing.assert_allclose(palm, (0, 0, 1.366), atol=1e-9)


def test_inertias_are_those_of_the_urdf(scene):
    """The tensors of link 2 (with ixz) and link 7 (with ixy), in the frames of the links."""
    expected = {
        "arm2": [[0.02076, 0, -0.003626], [0, 0.02179, 0], [-0.003626, 0, 0.00779]],
        "forearm": [[0.01464, 0.0005912, 0], [0.0005912, 0.01465, 0], [0, 0, 0.002872]],
    }
    for name, tensor in expected.items():
        body = scene.model.body(f"rh_{name}")
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, body.iquat)
        axes = turned.reshape(3, 3)
        np.testing.assert_allclose(axes @ np.diag(body.inertia) @ axes.T, tensor, atol=1e-9)


def test_the_left_arm_is_the_mirror_image_of_the_right_one(scene):
    """Fingertips, and where the masses are, in a random posture."""
    model, data = scene.model, mujoco.MjData(scene.model)
    each = len(scene.hand_start) // 2
    low, high = model.jnt_range[model.dof_jntid[scene.hand_qvel]][:each].T
    posture = np.random.default_rng(0).uniform(low, high)
    data.qpos[scene.hand_qpos] = np.tile(posture, 2)
    mujoco.mj_forward(model, data)
    right, left = np.split(data.site_xpos[scene.fingertip_sites], 2)
    np.testing.assert_allclose(left, right * (1, -1, 1), atol=1e-9)
    right, left = (data.xipos[model.body(p + "arm2").id] for p in ("rh_", "lh_"))
    np.testing.assert_allclose(left, right * (1, -1, 1), atol=1e-9)


def test_it_stays_where_it_is_against_gravity(scene):
    """Gravity is compensated, as the arm's own controller does."""
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = data.ctrl[:] = scene.hand_start
    names = [name.replace("A_", "") for name in scene.actuator_names]
    data.ctrl[:] = scene.hand_start[[scene.hand_joint_names.index(name) for name in names]]
    mujoco.mj_step(scene.model, data, 100)
    assert np.abs(data.qpos[scene.hand_qpos] - scene.hand_start).max() < 0.01


def within_limits(performance: Performance) -> None:
    """In every recorded state: joints, speeds, and parts of the robot that touch."""
    episode = performance.episode
    scene = build_scene(SceneConfig(**performance.settings["scene"]))
    model, data = scene.model, mujoco.MjData(scene.model)
    arm = [i for i, name in enumerate(scene.hand_joint_names) if "armJ" in name]
    low, high = model.jnt_range[model.dof_jntid[scene.hand_qvel]].T
    qpos = episode["hand_qpos"]
    assert (qpos[:, arm] > low[arm]).all()
    assert (qpos[:, arm] < high[arm]).all()
    assert (qpos > low - 0.05).all()  # soft, of fingers
    assert (qpos < high + 0.05).all()
    assert np.abs(episode["hand_qvel"][:, arm]).max() < SPEED
    of_arm = {model.body(prefix(side) + name).id for side in scene.sides for name in LINKS}
    for qpos, keys in zip(episode["hand_qpos"], episode["key_qpos"], strict=True):
        data.qpos[scene.hand_qpos], data.qpos[scene.key_qpos] = qpos, keys
        mujoco.mj_forward(model, data)
        touching = model.geom_bodyid[data.contact.geom]
        assert not np.isin(touching, list(of_arm)).any()


@pytest.mark.slow
def test_a_melody_is_played_within_all_limits():
    agent = make_agent("icp")
    task = TaskConfig(initial_buffer_time=1.0)
    scene = SceneConfig(hand="arm-allegro", hands="right")
    performance = play(MELODY, agent, task=task, scene=scene, num_threads=1)
    assert performance.metrics["f1"] > 0.95
    assert performance.track is not None
    assert not performance.track.dropped
    within_limits(performance)


def test_two_recordings_are_combined(tmp_path):
    """Its keys are those of either; and either is what its hand does with its actions alone."""
    agent = make_agent("icp", ICPConfig(rehearse=False))
    task = TaskConfig(initial_buffer_time=1.0)
    performance = play(DUET, agent, task=task, scene=SceneConfig(hand="arm-allegro", hands="apart"))
    assert performance.metrics["combined"] is True
    episode = performance.episode
    parts = hand_episodes(episode, performance.scene)
    assert list(parts) == ["right", "left"]
    sounding = [part["key_activation"] for part in parts.values()]
    assert all(each.any() for each in sounding)
    np.testing.assert_array_equal(episode["key_activation"], sounding[0] | sounding[1])
    for side, part in parts.items():
        alone = replayed(side, part["action"], task)
        np.testing.assert_array_equal(alone["key_qpos"], part["key_qpos"])
        np.testing.assert_array_equal(alone["hand_qpos"], part["hand_qpos"])
    within_limits(performance)
    performance.save(tmp_path)
    assert "of each hand by itself, combined" in (tmp_path / "report.html").read_text()
    assert read_json(tmp_path / "metrics.json", dict[str, Any])["combined"] is True
    for side, part in parts.items():
        kept = load_episode(tmp_path / f"episode-{side}.npz")
        np.testing.assert_array_equal(kept["key_activation"], part["key_activation"])


def replayed(side: str, actions: np.ndarray, task: TaskConfig) -> dict[str, np.ndarray]:
    """What actions make of one hand in a scene of its own."""
    config = SceneConfig(hand="arm-allegro", hands=side)  # type: ignore[arg-type]
    env = gymnasium.make("cadenza/Piano-v0", song=DUET, task=task, scene=config).unwrapped
    env.reset(seed=0)
    rows = []
    for action in actions:
        env.task.step(action[None])  # type: ignore[attr-defined]
        rows.append(env.task.state.copy())  # type: ignore[attr-defined]
    env.close()
    return {
        name: np.array([getattr(r, name)[0] for r in rows]) for name in ("key_qpos", "hand_qpos")
    }


@pytest.mark.parametrize("side", ["right", "left"])
def test_the_arm_brings_its_hand_level_to_where_it_is_said_to(side):
    """Links and tips of all fingers, against the posture at home moved along the keyboard."""
    scene = build_scene(SceneConfig(hand="arm-allegro", hands=side))
    servos = servos_of(scene)
    kinematics, rest = Kinematics(scene), rest_posture(servos)
    mount = ARM_ALLEGRO.body.mount
    assert mount is not None
    places = np.linspace(mount.low - mount.home, mount.high - mount.home, 9)
    places *= 1 if side == "right" else -1
    postures = RestPoses(kinematics).at({side: places}, len(places))
    points, at_home = kinematics.points(postures), kinematics.points(rest[None])
    moved = np.stack([np.zeros(9), places, np.zeros(9)], axis=1)[:, None, None]
    np.testing.assert_allclose(points, at_home + moved, atol=0.004)
    assert (postures > servos.low + 0.02).all()
    assert (postures < servos.high - 0.02).all()
