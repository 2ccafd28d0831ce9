"""Tests of where the forearms go for a song, against MuJoCo's kinematics."""

from contextlib import closing

import mujoco
import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import melody, reset

from cadenza.agents.planner.plan.song_plan import plan_song
from cadenza.learning.observation import GoalTable, Observer
from cadenza.learning.ranges import ranges_of
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.scene.servos import servos_of
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.setups import setup_named
from numbered import finger

THUMB, LITTLE = 0, 4
SONG = Score((Note(0.0, 0.5, 64, finger=finger(THUMB)), Note(0.5, 1.0, 72, finger=finger(LITTLE))))


def slides(task: PianoTask) -> list[int]:
    return [a for a, name in enumerate(task.scene.actuator_names) if name.endswith("forearm_tx")]


def above(task: PianoTask, forearm: float, finger: int, pitch: int) -> float:
    """The distance of a finger of the right hand at rest to the right of a key [m], by MuJoCo."""
    model, servos = task.scene.model, servos_of(task.scene)
    data = mujoco.MjData(model)
    data.qpos[task.scene.hand_qpos] = np.array([use.rest for use in servos.uses]) @ servos.joints
    joint = model.joint("rh_forearm_tx")
    data.qpos[joint.qposadr[0]] = forearm
    mujoco.mj_kinematics(model, data)
    tip = data.site_xpos[task.scene.fingertip_sites[finger], 1]
    return float(data.geom_xpos[task.scene.key_geoms][pitch - 21, 1] - tip)


def test_every_finger_gets_to_its_keys_and_5_cm_further():
    task = PianoTask([SONG])
    low, high = ranges_of(task).actions[:, slides(task)[0]]
    assert (
        high - low < 0.4 < np.subtract(task.spec.action_high, task.spec.action_low)[slides(task)[0]]
    )
    ranges = sorted(
        forearm
        for finger, pitch in ((THUMB, 64), (LITTLE, 72))
        for forearm in np.linspace(low, high, 2001)
        if abs(above(task, forearm, finger, pitch)) < 2e-4
    )
    assert_allclose([ranges[0] - low, high - ranges[-1]], 0.05, atol=1e-3)


def test_a_hand_without_notes_rests():
    task = PianoTask([SONG])
    ranges = ranges_of(task)
    assert_allclose(ranges.actions[:, slides(task)[1]], [-0.05, 0.05])


def test_keys_that_name_no_finger_are_for_all_of_them():
    """Thumb and little finger of the right hand may be asked for the lowest and the highest."""
    task = PianoTask([melody(60, 72)], TaskConfig(fingering="off"))
    low, high = ranges_of(task).actions[:, slides(task)[0]]
    for number in (THUMB, LITTLE):
        for pitch in (60, 72):
            assert above(task, low, number, pitch) * above(task, high, number, pitch) < 0


@pytest.mark.parametrize("option", ["random_pitch_shift", "random_octave_shift"])
def test_every_key_may_come_where_songs_are_moved(option):
    task = PianoTask([SONG], TaskConfig(**{option: 1}))
    ranges, a = ranges_of(task), slides(task)[0]
    assert ranges.actions[1, a] - ranges.actions[0, a] > 1.0


@pytest.mark.parametrize("hands", ["right", "both"])
def test_fingers_and_wrists_stay_near_their_rest(hands):
    """Whatever the music: only forearms along the keyboard depend on it."""
    scene = SceneConfig(hands=hands, forearm_dofs=("tx", "ty"))  # type: ignore[arg-type]
    task = PianoTask([SONG], scene=scene)
    low, high = ranges_of(task).actions
    for a, name in enumerate(task.scene.actuator_names):
        servo = task.scene.hand.servo(name.rpartition("_A_")[2])
        if a not in slides(task):
            near = servo.rest - servo.travel, servo.rest + servo.travel
            bounds = task.spec.action_low[a], task.spec.action_high[a]
            assert_allclose((low[a], high[a]), np.clip(near, *bounds))
            assert low[a] < servo.rest < high[a]
    assert (high - low < task.spec.action_high - task.spec.action_low)[slides(task)].all()


def test_joints_of_a_tendon_share_its_range():
    """Of a finger's last two joints each turns by half of what their tendon is pulled."""
    task = PianoTask([SONG])
    ranges, names = ranges_of(task), task.scene.hand_joint_names
    tendon = ranges.actions[:, task.scene.actuator_names.index("rh_A_FFJ0")]
    for joint in ("rh_FFJ1", "rh_FFJ2"):
        assert_allclose(ranges.joints[:, names.index(joint)], tendon / 2)


@pytest.mark.parametrize("drill", ["notes-6-0", "notes-6-2", "dyads-3-1"])
def test_the_plan_of_a_hand_that_stays_near_its_rest_is_within_reach(drill):
    """Forearms are where fingers at rest, not stretched ones, are over their keys."""
    options = setup_named("mini-allegro")
    scene, config = SceneConfig(**options.of(SceneConfig)), TaskConfig(initial_buffer_time=0.5)
    with closing(PianoTask([load_score(f"etudes/{drill}")], config, scene)) as task:
        ranges = ranges_of(task)
        forearm = slides(task)[0]
        plan = plan_song(task.tracks[0], task.state.hand_qpos[0]).nominal.tracking[0][:, forearm]
    low, high = ranges.actions[:, forearm]
    played = plan[5:]  # it begins in the middle of the keyboard
    assert np.quantile(played, 0.05) >= low
    assert np.quantile(played, 0.95) <= high
    assert high - low < 0.15
    knuckle = task.scene.actuator_names.index("rh_A_ffJ1")
    rest, travel = (task.scene.hand.servo("ffJ1").rest, task.scene.hand.servo("ffJ1").travel)
    assert_allclose(ranges.actions[:, knuckle], [rest - travel, rest + travel])
    joint = task.scene.hand_joint_names.index("rh_ffJ1")
    assert_allclose(ranges.joints[:, joint], ranges.actions[:, knuckle])


def test_acts_and_sees_on_that_scale():
    task = PianoTask([SONG], num_envs=2)
    scores, ranges = GoalTable(task.spec, task.tracks), ranges_of(task)
    observer = Observer(task.spec, scores, ranges=ranges)
    for end, rows in ((-1.0, ranges.actions[0]), (1.0, ranges.actions[1])):
        assert_allclose(
            ranges.ctrl(np.full((2, task.spec.action_size), end, np.float32)), [rows, rows]
        )
    assert_array_equal(
        ranges.ctrl(np.full((1, task.spec.action_size), 9, np.float32)), ranges.actions[1:]
    )
    reset(task)
    for _ in range(3):
        action = default_rng(0).uniform(-1, 1, (2, task.spec.action_size)).astype(np.float32)
        reward = task.step(ranges.ctrl(action)).reward.astype(np.float32)
        rest, zero = observer.proprioception(task.observation()), np.zeros(2, bool)
        seen = observer.observation(task.goals.row, rest, action, reward, zero)
        joints = seen[:, task.spec.observation_layout["joints"]]
        low, high = ranges.joints
        assert_allclose(low + (joints + 1) / 2 * (high - low), task.state.hand_qpos, atol=1e-6)
        assert_array_equal(seen[:, task.spec.observation_size : -1], action)
        keys = task.spec.observation_layout["key_state"]
        assert_array_equal(seen[:, keys], task.observation()[:, keys])
