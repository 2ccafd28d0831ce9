"""Domain randomization: each episode of each environment differs, and can be had again."""

import pickle
from dataclasses import asdict, fields
from typing import Any

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import cadenza
from begun import begun
from cadenza import CadenzaError, DomainRandomization, Note, SceneConfig, Score, TaskConfig
from cadenza.agents.agent import RandomAgent, ZeroAgent
from cadenza.agents.baselines.predictive_sampling import PredictiveSampling
from cadenza.agents.planner.config import PredictiveSamplingConfig
from cadenza.agents.playback import Playback
from cadenza.agents.rollout import play_episode
from cadenza.episode import load_episode
from cadenza.files import read_json
from cadenza.scene.randomization import POSE_FIELDS, SCALED_FIELDS
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.tasks.env import PianoVectorEnv
from cadenza.tasks.piano_task import PianoTask
from watched import watched

TUNE = Score((Note(0.0, 0.2, 60), Note(0.2, 0.4, 64), Note(0.2, 0.6, 43)), title="A tune")
ID = "cadenza/Piano-v0"
EACH: dict[str, Any] = {
    **dict.fromkeys(SCALED_FIELDS, (0.7, 1.4)),
    "key_travel": (0.9, 1.1),
    "key_sounding": (0.8, 0.95),
    "latency": (0.0, 0.12),
    "observation_latency": (0.0, 0.12),
    **dict.fromkeys(("joint_speed", "slide_speed"), (5.0, 10.0)),
    **dict.fromkeys(("joint_dead_band", "joint_backlash"), (0.0, 0.1)),
    **dict.fromkeys(("slide_dead_band", "slide_backlash"), (0.0, 0.01)),
    **dict.fromkeys(("joint_noise", "slide_noise", "key_noise", "control_noise"), 0.02),
    **{"joint_control_noise": 0.02, "slide_control_noise": 0.002},
    **dict.fromkeys(("keyboard_offset", "keyboard_tilt", "mount_offset", "mount_tilt"), 0.01),
    **dict.fromkeys(("joint_bias", "slide_bias", "gravity_tilt"), 0.02),
    **{"push": 30.0, "touch_noise": 0.1, "touch_bias": 0.1, "drift": 0.5},
}
ALL = DomainRandomization(**EACH)
SENSED = {
    "observation_latency",
    "joint_noise",
    "slide_noise",
    "key_noise",
    "joint_bias",
    "slide_bias",
}
# These show only where something is touched, sounds or is pushed; they have tests of their own.
QUIET = {"key_sounding", "touch_noise", "touch_bias", "drift", "push", *POSE_FIELDS}
DRAWN = {
    *(*SCALED_FIELDS, *POSE_FIELDS, "key_sounding", "gravity_tilt", "speed", "dead_band"),
    *("backlash", "latency", "observation_latency", "bias", "seed"),
}


def make(num_envs: int = 1, **options: Any) -> PianoVectorEnv:
    options = {"randomization": ALL, **options}
    return gym.make_vec(ID, num_envs, song=TUNE, **options).unwrapped  # type: ignore[return-value]


def actions(envs: PianoVectorEnv, steps: int = 20) -> NDArray[np.float32]:
    """The same in all environments, and a new one each step."""
    rng = np.random.default_rng(1)
    return np.repeat(
        rng.uniform(-0.5, 0.5, (steps, 1, envs.task.spec.action_size)), envs.num_envs, axis=1
    ).astype(np.float32)


def happens(envs: PianoVectorEnv, seed: Any = 0) -> list[NDArray[Any]]:
    """All that is seen, rewarded and true, over more than an episode; (steps, N, ...) each."""
    observation, _ = envs.reset(seed=seed)
    rows = [(observation, np.zeros(envs.num_envs), envs.task.state.hand_qpos)]
    for action in actions(envs):
        observation, reward, *_ = envs.step(action)
        rows.append((observation, reward, envs.task.state.hand_qpos))
    return [np.array(column) for column in zip(*rows, strict=True)]


# Seeds


@pytest.mark.parametrize("name", sorted(EACH.keys() - QUIET))
def test_environments_differ_in_each_field(name):
    seen, _, qpos = happens(make(4, randomization={name: EACH[name]}))
    parts = (seen, qpos) if name in SENSED else (qpos,)
    rows = {np.concatenate([part[:, i].ravel() for part in parts]).tobytes() for i in range(4)}
    assert len(rows) == 4


def test_another_seed_draws_others_and_the_same_the_same():
    first, again, other = (happens(make(2), seed) for seed in (0, 0, 5))
    for a, b, c in zip(first, again, other, strict=True):
        assert_array_equal(a, b)
        assert (a != c).any()


def test_episodes_of_one_environment_differ():
    envs = make(1)
    _, first = envs.reset(seed=0)
    _, second = envs.reset()
    assert (first["randomization/mass"] != second["randomization/mass"]).mean() > 0.9
    assert first["randomization/seed"] != second["randomization/seed"]


def test_a_field_draws_the_same_whatever_else_is_on():
    infos = [
        make(1, randomization=options).reset(seed=0)[1]
        for options in (ALL, {"mass": EACH["mass"]}, {"mass": EACH["mass"], "key_noise": 0.1})
    ]
    for info in infos[1:]:
        assert_array_equal(info["randomization/mass"], infos[0]["randomization/mass"])


@pytest.mark.parametrize(
    "off", [{}, {"seed": 3}, DomainRandomization(), {"mass": (1, 1), "latency": (0, 0)}]
)
def test_nothing_on_is_as_if_there_were_nothing(off):
    envs = make(2, randomization=off)
    plain = gym.make_vec(ID, 2, song=TUNE).unwrapped
    for a, b in zip(happens(envs), happens(plain), strict=True):  # type: ignore[arg-type]
        assert_array_equal(a, b)
    assert not envs.task.drawn


# What is told


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_infos_tell_what_was_drawn_for_each_episode(mode):
    envs = make(2, autoreset_mode=mode)
    _, infos = envs.reset(seed=0)
    names = {f"randomization/{name}" for name in DRAWN}
    assert {name for name in infos if name.startswith("randomization/")} == names
    assert infos["randomization/mass"].shape == (2, envs.task.scene.model.nbody)
    assert infos["_randomization/mass"].all()
    last = int(envs.task.goals.num_steps[0])
    for k, action in enumerate(actions(envs, last + 1), 1):
        if k > last and mode == AutoresetMode.DISABLED:
            _, later = envs.reset(options={"reset_mask": np.array([True, True])})
        else:
            *_, later = envs.step(action)
        begins = k == (last if mode == AutoresetMode.SAME_STEP else last + 1)
        assert ("randomization/mass" in later) == begins
        if begins:
            assert (later["randomization/seed"] != infos["randomization/seed"]).all()
            assert (later["randomization/mass"] != infos["randomization/mass"]).any(axis=1).all()
            assert later["_randomization/mass"].all()


def test_a_single_environment_tells_it_as_numbers_and_arrays():
    env = gym.make(ID, song=TUNE, randomization={"mass": (0.5, 2.0), "latency": (0.03, 0.03)})
    _, info = env.reset(seed=3)
    assert info["randomization/mass"].shape == (env.unwrapped.task.scene.model.nbody,)  # type: ignore[attr-defined]
    assert info["randomization/latency"] == pytest.approx(0.03)
    assert isinstance(info["randomization/seed"], int)


def test_an_episode_can_be_had_again_by_the_seed_that_its_info_tells():
    """One in the middle of many."""
    envs = make(2, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=0)
    observation, infos = envs.reset()
    again = make(1, randomization=asdict(ALL) | {"seed": int(infos["randomization/seed"][1])})
    theirs, _ = again.reset(seed=77)
    assert_array_equal(observation[1:], theirs)
    for action in actions(envs, 10):
        assert_array_equal(envs.step(action)[0][1:], again.step(action[1:])[0])


# What it does


def test_models_have_what_infos_tell_and_nothing_adds_up():
    """The heavier a key, the deeper it sags."""
    config = TaskConfig(randomization=DomainRandomization(mass=(0.5, 2.0)))
    task = PianoTask([TUNE], config, SceneConfig(hands="none"), 6)
    for _ in range(3):
        task.reset(np.random.default_rng(3).spawn(6), range(6))
        task.step(np.zeros((6, 89)))
        bodies = [
            task.scene.model.geom_bodyid[g] for g in range(*task.scene.key_geoms.indices(999))
        ]
        factor, depth = task.drawn["mass"][:, bodies], task.state.key_qpos
        correlation = [np.corrcoef(factor[:, k], depth[:, k])[0, 1] for k in range(88)]
        assert min(correlation) > 0.99


@pytest.mark.parametrize(("gain", "hands"), [(0.25, "both"), (0.25, "apart")])
def test_weaker_servos_lag(gain, hands):
    def reached(factor: float) -> NDArray[np.float64]:
        config = TaskConfig(randomization=DomainRandomization(servo_gain=(factor, factor)))
        task = begun(PianoTask([TUNE], config, SceneConfig(hands=hands)))
        ctrl = np.clip(
            np.full((1, task.spec.action_size), 0.2), task.spec.action_low, task.spec.action_high
        )
        task.step(ctrl)
        slides = task.scene.slide_joints
        return task.state.hand_qpos[0, slides] - task.scene.hand_start[slides]

    weak, nominal = reached(gain), reached(1.0)
    assert_allclose(weak, gain * nominal, rtol=0.2)


def test_planners_have_the_nominal_scene(scene):
    """Predictive sampling simulates, and from a nominal state chooses what it would anyway."""
    config = PredictiveSamplingConfig(num_candidates=2, horizon=0.1)
    chosen = []
    for randomization in (DomainRandomization(), DomainRandomization(mass=(0.5, 2.0))):
        agent = PredictiveSampling(config)
        task = begun(PianoTask([TUNE], TaskConfig(randomization=randomization), scene), agent)
        assert task.view().task.scene is scene
        chosen.append(agent.act(task.view()))
    assert_array_equal(*chosen)


def late(scene: Scene, latency: float, steps: int = 8) -> tuple[PianoTask, NDArray[Any]]:
    """(steps, J) where an action of the second forearm's way takes the hands."""
    config = TaskConfig(
        randomization=DomainRandomization(latency=(latency, latency)), random_hand_position=0.05
    )
    task = begun(PianoTask([TUNE], config, scene))
    ctrl = np.clip(
        np.full((1, task.spec.action_size), 0.1), task.spec.action_low, task.spec.action_high
    )
    ctrl[0, -1] = 1.0
    path, pedals = [], []
    for _ in range(steps):
        task.step(ctrl)
        path.append(task.state.hand_qpos[0].copy())
        pedals.append(task.pedal_down[0])
    return task, np.array([*map(np.append, path, pedals)])


def test_an_action_arrives_after_its_latency(scene):
    """Within a control step as MuJoCo's own steps have it, and steps later for longer ones."""
    _, at_once = late(scene, 0.0)
    _, late_step = late(scene, 0.1)
    _, part = late(scene, 0.12)
    slide = scene.slide_joints[0]
    start = late(scene, 0.0, 0)[0].state.hand_qpos[0, slide]
    assert_allclose(late_step[:2, slide], start, atol=1e-3)  # rests until then
    assert_allclose(late_step[2:, slide] - start, at_once[:-2, slide] - start, rtol=0.05, atol=1e-4)
    moved = np.abs(np.stack([at_once, late_step, part])[:, :, slide] - start)
    assert (moved[1, 2:] > moved[2, 2:]).all()
    assert (moved[2, 3:] > moved[1, 2:-1]).all()
    assert [rows[:4, -1].tolist() for rows in (at_once, late_step, part)] == [
        [1, 1, 1, 1],
        [0, 0, 1, 1],
        [0, 0, 1, 1],  # at the end of the third step, it has arrived
    ]


def test_a_latency_within_a_step_is_that_of_mujoco_stepped_by_hand(scene):
    task, path = late(scene, 0.015, 1)  # 3 of 10 physics steps
    fresh = late(scene, 0.015, 0)[0]
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = fresh.state.hand_qpos[0]
    rest = servos_of(scene).clip(fresh.state.hand_qpos[0] @ servos_of(scene).of_joints)
    then = np.clip(
        np.full(task.spec.action_size, 0.1), task.spec.action_low, task.spec.action_high
    )[:-1]
    for k in range(10):
        data.ctrl = rest if k < 3 else then
        mujoco.mj_step(model, data)
    assert_allclose(path[0, :-1], data.qpos[scene.hand_qpos], atol=1e-9)
    assert task.drawn["latency"][0] == pytest.approx(0.015)


def test_latency_is_rounded_to_physics_steps(scene):
    assert late(scene, 0.012, 0)[0].drawn["latency"][0] == pytest.approx(0.01)


def test_observations_have_noise_and_the_state_has_none(scene):
    noise = DomainRandomization(joint_noise=0.03, slide_noise=0.002, key_noise=0.05)
    task = PianoTask([TUNE], TaskConfig(randomization=noise), scene, 4)
    task.reset(np.random.default_rng(0).spawn(4), range(4))
    off, parts = [], task.spec.observation_layout
    low, high = np.inf, -np.inf
    for _ in range(25):
        seen = task.observation()
        assert_array_equal(seen, task.view().observation)  # looked at twice, it is the same
        off.append(seen[:, parts["joints"]] - task.state.hand_qpos)
        keys = seen[:, parts["key_state"]]
        low, high = min(low, keys.min()), max(high, keys.max())
        assert set(np.unique(seen[:, parts["goal"]])) <= {0, 1}
        task.step(np.tile(np.clip(0, task.spec.action_low, task.spec.action_high), (4, 1)))
    slides = np.array(
        [name.split("forearm")[-1] in ("_tx", "_ty") for name in scene.hand_joint_names]
    )
    assert_allclose(np.std(np.array(off)[..., slides]), 0.002, rtol=0.2)
    assert_allclose(np.std(np.array(off)[..., ~slides]), 0.03, rtol=0.05)
    assert low == 0.0
    assert 0.05 < high < 0.5


def test_controls_have_noise_in_each_step_and_environment(scene, monkeypatch):
    stepped = watched(monkeypatch, MujocoSimulation, "step")
    config = TaskConfig(randomization=DomainRandomization(control_noise=0.05))
    task = PianoTask([TUNE], config, scene, 4)
    task.reset(np.random.default_rng(0).spawn(4), range(4))
    half = (task.spec.action_high - task.spec.action_low)[:-1] / 2
    middle = (task.spec.action_low + task.spec.action_high) / 2
    for _ in range(10):
        task.step(np.tile(middle, (4, 1)))
    noise = (np.array([ctrl for (_, ctrl, *_), _ in stepped]) - middle[:-1]) / half
    assert_allclose(noise.std(), 0.05, rtol=0.05)
    assert len(np.unique(noise)) == noise.size


# A world that differs


def playing(scene: SceneConfig | Scene, steps: int = 12, **options: Any) -> PianoTask:
    """A task whose hands have moved a while, as the same random actions have it."""
    config = TaskConfig(randomization=DomainRandomization(**options))
    task, rng = begun(PianoTask([TUNE], config, scene)), np.random.default_rng(1)
    for _ in range(steps):
        middle = (task.spec.action_low + task.spec.action_high) / 2
        spread = 0.3 * (task.spec.action_high - middle)
        task.step((middle + spread * rng.uniform(-1, 1, len(middle)))[None])
    return task


@pytest.mark.parametrize("hands", ["both", "apart"])
@pytest.mark.parametrize("steps", [0, 1, 2])
def test_observations_are_late_by_control_steps(hands, steps):
    late = playing(SceneConfig(hands=hands), 12, observation_latency=(steps * 0.05,) * 2)
    then = playing(SceneConfig(hands=hands), 12 - steps)
    for name in ("hand_qpos", "hand_qvel", "key_qpos"):
        assert_array_equal(getattr(late.sensed, name), getattr(then.state, name), err_msg=name)
    parts = late.spec.observation_layout
    assert_array_equal(
        late.observation()[:, parts["joints"]], then.observation()[:, parts["joints"]]
    )
    assert late.drawn.get("observation_latency", [0.0])[0] == pytest.approx(steps * 0.05)


def test_observations_are_late_by_physics_steps(scene):
    """They are what MuJoCo itself has so long before."""
    task = playing(scene, 1, observation_latency=(0.02, 0.02))
    model, data = scene.model, mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = scene.hand_start
    middle = (scene.action_low + scene.action_high) / 2
    spread = 0.3 * (scene.action_high - middle)
    data.ctrl = (middle + spread * np.random.default_rng(1).uniform(-1, 1, len(middle)))[:-1]
    for _ in range(6):  # of 10
        mujoco.mj_step(model, data)
    assert_allclose(task.sensed.hand_qpos[0], data.qpos[scene.hand_qpos], atol=1e-9)


def test_onsets_are_heard_when_they_arrive():
    """A key of a piano that plays itself sounds, and is heard 0.12 s later, as loud."""
    onsets = []
    for late in (0.0, 0.12):
        config = TaskConfig(randomization=DomainRandomization(observation_latency=(late, late)))
        task = begun(PianoTask([TUNE], config, SceneConfig(hands="none")))
        for step in range(8):
            task.step(np.where(np.arange(89) == 40, task.spec.action_high, 0.0)[None])
            if np.isfinite(task.sensed.key_onset[0, 40]):
                onsets.append(
                    (step * 0.05 + task.sensed.key_onset[0, 40], task.sensed.key_speed[0, 40])
                )
    assert len(onsets) == 2
    assert onsets[1][0] - onsets[0][0] == pytest.approx(0.12)
    assert onsets[1][1] == onsets[0][1]


def test_biases_stay_and_drift_wanders(scene):
    def off(steps: int, **more: float) -> NDArray[Any]:
        task = playing(scene, steps, joint_bias=0.02, slide_bias=0.001, seed=4, **more)
        return task.sensed.hand_qpos[0] - task.state.hand_qpos[0]

    assert_allclose(off(0), off(12), atol=1e-12)
    hinges = np.abs(scene.hand_start) >= 0  # all of them, slides set apart below
    hinges[[0, 1, 23, 24]] = False
    assert_allclose(off(0)[hinges].std(), 0.02, rtol=0.4)
    assert abs(off(0)[~hinges]).max() < 0.004
    wandered = [off(n, drift=1.0) - off(n) for n in (1, 12)]
    assert 0 < np.linalg.norm(wandered[0]) < np.linalg.norm(wandered[1])


def test_agents_see_fingertips_where_joints_seem_to_be(scene):
    task = playing(scene, 5, joint_bias=0.05)
    data = mujoco.MjData(scene.model)
    data.qpos[scene.hand_qpos] = task.view().state.hand_qpos[0]
    mujoco.mj_kinematics(scene.model, data)
    off = task.view().state.fingertip_xpos[0] - data.site_xpos[scene.fingertip_sites]
    true = abs(task.view().state.fingertip_xpos - task.state.fingertip_xpos)
    assert abs(off).max() < 0.3 * true.max()  # two joints of one tendon are seen as it has them


@pytest.mark.parametrize("hands", ["both", "apart"])
def test_the_keyboard_lies_where_infos_tell(hands):
    config = SceneConfig(hands=hands)
    there = playing(config, 0).state.key_xpos[0]
    task = playing(config, 0, keyboard_offset=0.01, keyboard_tilt=0.02)
    offset, tilt = (task.drawn[f"keyboard_{name}"][0] for name in ("offset", "tilt"))
    turned = Rotation.from_rotvec(tilt).apply(there) + offset
    assert_allclose(task.state.key_xpos[0], turned, atol=1e-12)
    assert abs(turned - there).max() > 2e-3


@pytest.mark.parametrize("hands", ["both", "apart"])
def test_hands_are_mounted_where_infos_tell(hands):
    config = SceneConfig(hands=hands)
    there = playing(config, 0).state.fingertip_xpos[0]
    task = playing(config, 0, mount_offset=0.01)
    off = (task.state.fingertip_xpos[0] - there).reshape(2, 5, 3)
    assert_allclose(off, np.repeat(task.drawn["mount_offset"][0][:, None], 5, axis=1), atol=1e-12)


@pytest.mark.parametrize("hands", ["none", "apart"])
def test_keys_sound_from_the_depth_and_stop_at_the_end_that_infos_tell(hands):
    """Keys that go down by themselves, or do not move; either way states and events agree."""
    ranges = DomainRandomization(key_sounding=(0.2, 0.9), key_travel=(0.9, 1.1))
    task = begun(PianoTask([TUNE], TaskConfig(randomization=ranges), SceneConfig(hands=hands)))
    keyboard, sounded = task.scene.keyboard, task.sounding.copy()
    sounds_from = keyboard.sounds_from * task.drawn["key_sounding"][0]
    for _ in range(20):
        task.step(task.spec.action_high[None] * 0.9)
        assert_array_equal(task.sounding[0], task.state.key_qpos[0] >= sounds_from)
        changed = ~np.isnan(task.state.key_onset[0]) | ~np.isnan(task.state.key_offset[0])
        assert changed[task.sounding[0] != sounded[0]].all()
        sounded = task.sounding.copy()
    assert hands == "apart" or sounded.all()


def test_setpoints_have_limits_of_speed_dead_bands_and_backlash(scene, monkeypatch):
    stepped = watched(monkeypatch, MujocoSimulation, "step")
    names = [name.split("/")[-1] for name in scene.actuator_names]
    own = [next(i for i, n in enumerate(names) if n.endswith(e)) for e in ("FFJ3", "forearm_tx")]
    middle = ((scene.action_low + scene.action_high) / 2)[None]

    def sent(offsets: list[float], **options: Any) -> NDArray[Any]:
        """(steps, 2) where a joint and a slide are sent, from the middle of their ranges."""
        stepped.clear()
        config = TaskConfig(randomization=DomainRandomization(**options))
        task = begun(PianoTask([TUNE], config, scene))
        for offset in [0.0] * 8 + offsets:
            ctrl = middle.copy()
            ctrl[0, own] += offset
            task.step(ctrl)
        arrived = [ctrl[0] for (_, ctrl, *_), _ in stepped[8:]]
        return np.array(arrived)[:, own] - middle[0, own]

    joint, slide = sent([0.4] * 4, joint_speed=(3.0, 3.0), slide_speed=(5.0, 5.0)).T
    assert_allclose(joint, [0.15, 0.3, 0.4, 0.4])
    assert_allclose(slide, [0.25, 0.4, 0.4, 0.4])
    ctrls = [0.04, 0.06, 0.1]
    joint, slide = sent(ctrls, joint_dead_band=(0.05, 0.05), slide_dead_band=(0.03, 0.03)).T
    assert_allclose(joint, [0.0, 0.06, 0.06], atol=1e-12)
    assert_allclose(slide, [0.04, 0.04, 0.1], atol=1e-12)
    joint, slide = sent([0.4, 0.35, 0.0], joint_backlash=(0.2, 0.2)).T
    assert_allclose(np.diff(joint), [0.0, -0.2], atol=1e-12)
    assert_allclose(np.diff(slide), [-0.05, -0.35], atol=1e-12)


def test_noise_on_controls_of_joints_and_slides(scene, monkeypatch):
    stepped = watched(monkeypatch, MujocoSimulation, "step")
    noise = DomainRandomization(joint_control_noise=0.02, slide_control_noise=0.002)
    task = begun(PianoTask([TUNE], TaskConfig(randomization=noise), scene))
    middle = ((scene.action_low + scene.action_high) / 2)[None]
    for _ in range(100):
        task.step(middle)
    errors = np.array([ctrl[0] for (_, ctrl, *_), _ in stepped]) - middle[0, :-1]
    for part, std in (("forearm_t", 0.002), ("J3", 0.02), ("J0", 0.04)):  # J0 turns two joints
        own = [part in name for name in scene.actuator_names]
        assert_allclose(errors[:, own].std(), std, rtol=0.15)


def test_gravity_off_its_direction_and_pushes_move_hands(scene):
    still = playing(scene, 40).state.hand_qpos
    for options in ({"gravity_tilt": 0.1}, {"push": 50.0}):
        moved = np.abs(playing(scene, 40, **options).state.hand_qpos - still)
        assert 1e-5 < moved.max() < 0.3


# Recordings and options


def test_a_recorded_episode_plays_again_to_the_bit(tmp_path):
    task = TaskConfig(randomization=ALL, random_hand_position=0.02)
    played = cadenza.play(TUNE, RandomAgent(), 4, task=task)
    played.save(tmp_path)
    recorded = load_episode(tmp_path / "episode.npz")
    settings = read_json(tmp_path / "settings.json", dict[str, Any])
    read = TaskConfig(**settings["task"])
    again = play_episode(PianoTask([TUNE], read), Playback(recorded["action"]), settings["seed"])
    drawn = {n for n in recorded.arrays if n.startswith("randomization_")}
    assert drawn == {f"randomization_{name}" for name in DRAWN}
    for name in {"hand_qpos", "key_qpos", "reward_total", *drawn}:
        assert_array_equal(recorded[name], again.episode[name])
    seed = int(recorded["randomization_seed"])
    by_seed = TaskConfig(randomization=DomainRandomization(**EACH, seed=seed))
    start = play_episode(PianoTask([TUNE], by_seed), ZeroAgent(), 99).episode
    assert_array_equal(start["randomization_mass"], recorded["randomization_mass"])


def test_a_spec_has_it_as_a_dictionary_or_a_value():
    for randomization in (ALL, asdict(ALL)):
        env = gym.make(ID, song="CMajorScaleOneHand", randomization=randomization)
        again = gym.make(pickle.loads(pickle.dumps(env.spec)))
        seen = [each.reset(seed=1)[0] for each in (env, again)]
        assert_array_equal(*seen)
    text = env.spec.to_json()  # type: ignore[union-attr]
    assert_array_equal(
        gym.make(gym.envs.registration.EnvSpec.from_json(text)).reset(seed=1)[0], seen[0]
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mass": (1.2, 0.8)}, "randomization.mass 1.2 0.8: give the least and the greatest"),
        ({"mass": (0.0, 1.0)}, "both from 0.01 to 100"),
        ({"friction": (-0.1, 1.0)}, "randomization.friction -0.1 1.0"),
        ({"servo_gain": (1.0, float("inf"))}, "randomization.servo_gain 1.0 inf"),
        ({"key_spring": (float("nan"), 1.0)}, "randomization.key_spring nan 1.0"),
        ({"latency": (0.0, 2.0)}, "randomization.latency 0.0 2.0"),
        ({"key_noise": -1.0}, "randomization.key_noise -1.0: choose 0.0 to 1.0"),
        ({"joint_noise": float("nan")}, "randomization.joint_noise nan"),
        ({"seed": -1}, "randomization.seed -1: choose 0"),
        ({"mass": 0.1}, "randomization.mass 0.1: give 2 of them; for each, give a number"),
        ({"mass": (1.0, 1.0, 1.0)}, "randomization.mass .* give 2 of them"),
        ({"weight": (1.0, 2.0)}, "randomization has no 'weight': choose from mass, friction"),
        (0.1, "randomization 0.1: give a DomainRandomization or a dictionary"),
        ("harsh", "randomization 'harsh': a profile is a setup='harsh'"),
    ],
)
def test_says_what_makes_no_sense(options, message):
    with pytest.raises(CadenzaError, match=message) as error:
        gym.make(ID, song=TUNE, randomization=options)
    assert "\n" not in str(error.value)


def test_every_field_is_tried_here():
    assert {each.name for each in fields(DomainRandomization)} == {*EACH, "seed", "robot"}
