"""The task against recorded episodes of the published system (see tests/data)."""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from begun import begun
from cadenza.music.libraries.library import load_score
from cadenza.music.metrics import playing_metrics
from cadenza.scene.scene import Scene, build_scene
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.tasks import reward
from cadenza.tasks.augmentation import prepare_tracks
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.setups import configure

DATA = Path(__file__).parents[1] / "data"
EXACT = {"rtol": 0, "atol": 1e-6}


class Recording:
    """One recorded episode, the scene that it was recorded in, and the score that was asked for."""

    def __init__(self, name: str, **options: Any) -> None:
        with np.load(DATA / f"episode_{name}.npz") as file:
            self.arrays = dict(file)
        recorded_with = {
            name: bool(self[name]) for name in ("trim_silence", "reduced_action_space")
        }
        self.config, scene = configure({"setup": "published"} | recorded_with | options)
        self.scene = build_scene(scene)
        self.score = load_score(str(self["song"]))
        (track,) = prepare_tracks([self.score], self.config, self.scene)
        self.goals = track.goals

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]

    def task(self) -> PianoTask:
        return begun(PianoTask([self.score], self.config, self.scene))


@pytest.fixture(scope="module", params="abcd")
def recording(request):
    return Recording(request.param, sleeping_keys=True)


@pytest.mark.parametrize("name", "ad")
def test_keys_that_never_sleep_replay_the_whole_recording(name):
    """To the bit on the machine that wrote this; a C library may round sines otherwise."""
    recording = Recording(name)
    task = recording.task()
    for step, action in enumerate(recording["action"]):
        task.step(action[None])
        for field in ("hand_qpos", "hand_qvel", "key_qpos", "fingertip_xpos"):
            ours = getattr(task.state, field)[0]
            assert_allclose(ours, recording[field][step], rtol=0, atol=1e-8, err_msg=field)
    published = json.loads(str(recording["metrics"]))
    ours = task.episode_metrics(0)
    assert_allclose([ours[k] for k in published], list(published.values()), atol=1e-12)


def test_names_and_ranges_of_actions(recording):
    scene = recording.scene
    assert_allclose(scene.action_low, recording["action_min"], **EXACT)
    assert_allclose(scene.action_high, recording["action_max"], **EXACT)
    published = [name.split("/")[1] for name in recording["actuator_names"]]
    assert [n.replace("A_forearm", "forearm")[3:] for n in scene.actuator_names] == [
        n.removeprefix("rh_").removeprefix("lh_") for n in published
    ]
    assert [n.removeprefix("rh_").removeprefix("lh_") for n in scene.hand_joint_names] == [
        n.split("/")[1].removeprefix("rh_").removeprefix("lh_")
        for n in recording["hand_joint_names"]
    ]


def test_rewards_follow_from_recorded_states(recording):
    goals = recording.goals
    key_qpos = recording["key_qpos"]
    keyboard = recording.scene.keyboard
    state = reward.key_state(key_qpos, keyboard.travel)
    activation = reward.key_activation(key_qpos, keyboard.sounds_from)
    press = reward.press_offset(keyboard.half_size)
    assert_array_equal(activation, recording["key_activation"])
    force, velocity = servo_force_and_velocity(recording)
    tips, centres = recording["fingertip_xpos"], key_centres(recording)
    terms = {
        "key_press": reward.key_press(state, activation, goals.keys),
        "fingering": reward.score_fingering(tips, centres, press, goals.fingers),
        "energy": reward.energy(force, velocity, recording.config.energy_coefficient),
        "sustain": reward.sustain(recording["sustain_activation"], goals.sustain),
        "forearm": reward.forearm(np.zeros(goals.num_steps, bool)),
    }
    for name, term in terms.items():
        assert_allclose(term, recording[f"reward_{name}"], err_msg=name, **EXACT)
    assert_allclose(sum(terms.values()), recording["reward_total"], **EXACT)


def test_hands_that_touch_cost_the_reward_for_forearms():
    """Postures with the published reward: forearms that touch, hands that do, and neither."""
    with np.load(DATA / "published_touches.npz") as published:
        postures, expected = published["hand_qpos"], published["forearm"]
        joints = tuple(published["joints"])
    scene = build_scene()
    assert scene.hand_joint_names == joints
    simulation = MujocoSimulation(scene, len(postures), 0.05, 1, watch_forearms=True)
    simulation.reset(hand_qpos=postures)
    assert_array_equal(reward.forearm(simulation.state.forearm_contact), expected)
    assert 0 < (expected == 0).mean() < 1
    simulation.close()


def key_centres(recording: Recording) -> np.ndarray:
    """(T, 88, 3) where MuJoCo puts the keys' boxes at the recorded angles."""
    scene, centres = recording.scene, []
    data = mujoco.MjData(scene.model)
    for qpos in recording["key_qpos"]:
        data.qpos[scene.key_qpos] = qpos
        mujoco.mj_kinematics(scene.model, data)
        centres.append(data.geom_xpos[scene.key_geoms].copy())
    return np.array(centres)


def servo_force_and_velocity(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Force and velocity of the servos in the last physics step before each recorded state.

    A semi-implicit Euler step moves positions by the new velocity, so the positions that the
    forces came from are one step of the new velocity earlier.
    """
    scene: Scene = recording.scene
    model, data = scene.model, mujoco.MjData(scene.model)
    force, velocity = [], []
    for action, qpos, qvel in zip(
        recording["action"], recording["hand_qpos"], recording["hand_qvel"], strict=True
    ):
        data.qvel[scene.hand_qvel] = qvel
        data.qpos[scene.hand_qpos] = qpos - model.opt.timestep * qvel
        data.ctrl = action[:-1]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        force.append(data.actuator_force.copy())
        velocity.append(data.actuator_velocity.copy())
    return np.array(force), np.array(velocity)


def test_metrics_follow_from_recorded_states(recording):
    goals = recording.goals
    ours = playing_metrics(
        recording["key_activation"],
        recording["sustain_activation"],
        goals.keys,
        goals.sustain,
        recording.config.control_timestep,
        recording.score,
    )
    published = json.loads(str(recording["metrics"]))
    assert_allclose([ours[name] for name in published], list(published.values()), **EXACT)


def test_replaying_the_actions(recording):
    """Goal and fingering are observed as recorded, hands and keys move as recorded."""
    task = recording.task()
    goal = task.spec.observation_layout["goal"]
    fingering = task.spec.observation_layout["fingering"]
    assert_array_equal(task.observation()[0, goal], recording["goal_obs0"])
    assert_array_equal(task.observation()[0, fingering], recording["fingering_obs0"])
    assert_array_equal(task.state.hand_qpos[0], recording["hand_qpos0"])
    seen: dict[str, list[np.ndarray]] = {name: [] for name in ("goal", "fingering")}
    moved: dict[str, list[np.ndarray]] = {
        name: [] for name in ("hand_qpos", "hand_qvel", "key_qpos", "fingertip_xpos")
    }
    for step, action in enumerate(recording["action"]):
        transition = task.step(action[None])
        assert bool(transition.truncated[0]) == (step == len(recording["action"]) - 1)
        seen["goal"].append(task.observation()[0, goal])
        seen["fingering"].append(task.observation()[0, fingering])
        for name, values in moved.items():
            values.append(getattr(task.state, name)[0])
    assert_array_equal(seen["goal"], recording["goal_obs"])
    assert_array_equal(seen["fingering"], recording["fingering_obs"])
    for name in ("hand_qpos", "key_qpos", "fingertip_xpos"):
        assert_allclose(
            np.array(moved[name])[:40], recording[name][:40], rtol=0, atol=1e-3, err_msg=name
        )
    published = json.loads(str(recording["metrics"]))
    ours = task.episode_metrics(0)
    for name, value in published.items():
        assert abs(ours[name] - value) < 0.05, name
