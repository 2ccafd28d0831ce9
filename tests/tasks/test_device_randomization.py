"""Domain randomization on the device: the draws of the CPU, others in each world and episode."""

from copy import copy
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_functional import ONE_NOTE, Data, RecordedPhysics

from cadenza.errors import CadenzaError
from cadenza.scene.randomization import SCALED_FIELDS, scale
from cadenza.scene.scene import Scene
from cadenza.sim.protocol import Path, State
from cadenza.tasks.config import DomainRandomization, TaskConfig
from cadenza.tasks.draw_ranges import DrawRanges
from cadenza.tasks.piano_task import EpisodeStart, PianoTask
from cadenza.tasks.randomization import Randomization
from cadenza.tasks.registration import make_vector_env
from cadenza.tasks.view import task_spec

jax = pytest.importorskip("jax")

from cadenza.tasks import device_randomization  # noqa: E402
from cadenza.tasks.device_randomization import DeviceRandomization  # noqa: E402
from cadenza.tasks.functional import FunctionalPianoTask, PianoState  # noqa: E402

DT = 0.05  # [s]
EVENTS = "key_onset", "key_offset", "key_speed"
FACTORS: Any = dict.fromkeys(SCALED_FIELDS, (0.7, 1.4))


@pytest.fixture(autouse=True)
def _few_variants(monkeypatch):
    """Models are computed for fewer seeds, to save time."""
    monkeypatch.setattr(device_randomization, "VARIANTS", 16)


class Following(RecordedPhysics):
    """Joints are where the first of the controls are, scaled by the heaviness of the bodies."""

    def __init__(self, scene: Scene, num_envs: int, *_: Any, **options: Any) -> None:
        super().__init__(scene, num_envs)
        self.joints = self.zeros.hand_qpos.shape[1]

    def step(
        self, data: Data, ctrl: Any, held: Any = None, models: Any = None
    ) -> tuple[Data, State]:
        state = jax.tree.map(jax.numpy.asarray, self.zeros)
        if models:
            ctrl = ctrl * models["body_mass"].sum(axis=1, keepdims=True)
        padded = jax.numpy.pad(ctrl, ((0, 0), (0, self.joints - ctrl.shape[1])))
        return data, state._replace(hand_qpos=padded)


def played(
    randomization: DomainRandomization, *seeds: int, num_envs: int = 3
) -> list[list[PianoState]]:
    """More than an episode for each seed, by the same actions in all environments."""
    config = TaskConfig(initial_buffer_time=0.0, randomization=randomization)
    task = FunctionalPianoTask([ONE_NOTE], config, None, num_envs, Following)
    actions = np.random.default_rng(0).uniform(-1, 1, (7, 1, 39)).repeat(num_envs, axis=1)
    runs = [[task.reset(jax.random.key(seed))] for seed in seeds]
    for states in runs:
        for action in actions:
            states.append(task.step(states[-1], action))
    return runs


def seen(states: list[PianoState]) -> Any:
    """(steps, N, D) observations."""
    return np.array([state.obs for state in states])


@pytest.mark.parametrize(
    "on",
    [
        {"mass": (0.7, 1.4)},
        pytest.param({"latency": (0.0, 0.3)}, marks=pytest.mark.slow),
        {"joint_noise": 0.02},
        pytest.param({"control_noise": 0.02}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_worlds_and_episodes_differ_by_the_seed(on):
    first, again, other = played(DomainRandomization(**on), 0, 0, 1)
    assert_array_equal(seen(first), seen(again))
    assert (seen(first) != seen(other)).any(axis=(0, 2)).all()
    assert len({row.tobytes() for row in np.moveaxis(seen(first), 1, 0)}) == 3
    seeds = [state.info["randomization/seed"] for state in first]
    if on.keys() & {"mass", "latency"}:
        assert (seeds[0] != seeds[-1]).all()  # of the next episode


@pytest.mark.slow
def test_ranges_without_width_change_no_bit():
    same: Any = dict.fromkeys(SCALED_FIELDS, (1.0, 1.0))
    (off,), (on,) = (
        played(each, 0) for each in (DomainRandomization(), DomainRandomization(**same))
    )
    assert_array_equal(seen(on), seen(off))
    (fixed,) = played(DomainRandomization(mass=(1.2, 1.2)), 0)
    assert_array_equal(seen(fixed)[:, 1:], seen(fixed)[:, :-1])


def test_models_are_those_of_the_cpu(scene):
    config = DomainRandomization(**FACTORS, seed=5)
    random = DeviceRandomization(config, scene, DT, 2)
    key = jax.random.key(0)
    draws = random.begin(key, at_start(scene))
    _, _, others = random.send(draws, np.zeros((2, len(scene.action_low))), key)
    model = copy(scene.model)
    scale(model, scene, DrawRanges(config, scene, DT).factors(5), mujoco.MjData(scene.model))
    for name, values in others["models"].items():
        assert_array_equal(values[1], getattr(model, name).astype(np.float32), err_msg=name)
    changed = {name for fields in SCALED_FIELDS.values() for name in fields}
    assert changed < others["models"].keys()


def at_start(scene: Scene) -> State:
    """Two worlds that have been reset."""
    return State.at_rest(scene, 2)._replace(hand_qpos=np.tile(scene.hand_start, (2, 1)))


class Listening:
    """A simulation that keeps what arrives, and moves as it is told."""

    def __init__(self, scene: Scene) -> None:
        self.state, self.pushes = at_start(scene), {}
        self.next: tuple[State, Path] | None = None

    def reset(self, *_: Any) -> None: ...
    def randomize(self, *_: Any) -> None: ...
    def close(self) -> None: ...

    def push(self, env: int, force: Any) -> None:
        self.pushes[env] = force

    def step(self, ctrl: Any, env_ids: Any, held: Any = None, path: Path | None = None) -> None:
        self.arrived = ctrl, held
        if self.next is not None:
            self.state, way = self.next
            for values, new in zip(way if path is None else path, way, strict=True):
                values[:] = new


def begun(config: DomainRandomization, scene: Scene) -> tuple[Any, ...]:
    """Episodes with the same seed on the host, of a simulation, and on the device."""
    listening, start = Listening(scene), at_start(scene)
    host = Randomization(config, scene, DT, 2, listening)  # type: ignore[arg-type]
    host.begin([0, 1], np.random.default_rng(0).spawn(2), start.hand_qpos, [None, None])
    host.start_sensing([0, 1], start)
    device, key = DeviceRandomization(config, scene, DT, 2), jax.random.key(0)
    on_device = State._make(map(jax.numpy.asarray, start))
    return listening, host, device, device.begin(key, on_device), key


@pytest.mark.parametrize("latency", [0.005, 0.015, 0.05, 0.1, 0.12])
def test_actions_arrive_when_they_do_on_the_cpu(scene, latency):
    """After exactly so many control steps, and physics steps within one."""
    config = DomainRandomization(latency=(latency, latency), seed=1)
    listening, host, device, draws, key = begun(config, scene)
    rng, sent = np.random.default_rng(0), []
    for step in range(6):
        sent.append(rng.uniform(scene.action_low, scene.action_high, (2, len(scene.action_low))))
        arrived = host.step(sent[-1], slice(None))
        draws, ours, others = device.send(draws, sent[-1].astype(np.float32), key)
        assert_allclose(ours, arrived, atol=1e-6)
        _, held = listening.arrived
        assert_allclose(others["held"].ctrl, held.ctrl, atol=1e-6)
        assert_array_equal(others["held"].substeps, held.substeps)
        steps, part = divmod(round(latency / scene.model.opt.timestep), 10)
        assert_array_equal(held.substeps, part)
        if step >= steps:
            assert_allclose(ours, sent[step - steps], atol=1e-6)


@pytest.mark.parametrize(
    "on",
    [
        {"joint_speed": (0.5, 10.0), "slide_speed": (0.5, 10.0)},
        {"joint_dead_band": (0.0, 0.3), "slide_dead_band": (0.0, 0.1)},
        {"joint_backlash": (0.0, 0.2), "slide_backlash": (0.0, 0.1)},
        {"joint_speed": (0.0, 5.0), "joint_dead_band": (0.1, 0.1), "joint_backlash": (0.1, 0.2)},
        {"gravity_tilt": 0.2},
    ],
    ids=str,
)
def test_servos_and_gravity_are_those_of_the_cpu(scene, on):
    """Of the same robot: limits of speed, dead bands, backlash, and the direction of gravity."""
    config = DomainRandomization(**on, robot=3)
    listening, host, device, draws, key = begun(config, scene)
    rng, low, high = np.random.default_rng(0), scene.action_low, scene.action_high
    for _ in range(8):
        ctrl = rng.uniform(low, high, (2, len(low)))
        arrived = host.step(ctrl, slice(None))
        draws, ours, others = device.send(draws, ctrl.astype(np.float32), key)
        assert_allclose(ours, arrived, atol=2e-6)
        for env, force in listening.pushes.items():
            assert_allclose(others["force"][env], force, atol=1e-5)
    assert (abs(arrived - ctrl).max() > 1e-3) == ("gravity_tilt" not in on)
    assert bool(listening.pushes) == ("gravity_tilt" in on)


def test_pushes_are_as_strong_and_as_rare_as_it_says(scene):
    device = DeviceRandomization(DomainRandomization(push=10.0), scene, DT, 500)
    state = State.at_rest(scene, 500)
    draws = device.begin(jax.random.key(0), State._make(map(jax.numpy.asarray, state)))
    _, _, others = device.send(draws, np.zeros((500, 39), np.float32), jax.random.key(1))
    force = np.linalg.norm(others["force"], axis=2)
    assert_allclose((force > 0).any(axis=1).mean(), DT, atol=0.02)  # one a second
    assert set(np.nonzero(force)[1]) <= set(scene.palm_bodies)
    assert 3.0 < force[force > 0].mean() < 7.0
    assert force.max() <= 10.0


@pytest.mark.parametrize(
    "on",
    [
        {"joint_bias": 0.03, "slide_bias": 0.002, "touch_bias": 0.5},
        {"observation_latency": (0.0, 0.13)},
        {"observation_latency": (0.05, 0.05), "joint_bias": 0.01},
    ],
    ids=str,
)
def test_sensors_are_those_of_the_cpu(scene, on):
    """As far off, and as late: joints, keys, touch, and when and how loud keys sounded."""
    config = DomainRandomization(**on, seed=4)
    listening, host, device, draws, key = begun(config, scene)
    rng, onsets = np.random.default_rng(0), 0
    for _ in range(8):
        way = Path.still(listening.state, 11)
        way = Path(*(values + 0.01 * rng.random(values.shape) for values in way))
        onset = np.where(rng.random((2, 88)) < 0.1, rng.uniform(0, DT, (2, 88)), np.nan)
        state = listening.state._replace(
            **{name: values[:, -1] for name, values in way._asdict().items()},
            key_onset=onset,
            key_offset=onset + 0.001,
            key_speed=np.where(np.isnan(onset), np.nan, rng.random((2, 88))),
        )
        listening.next = state, way
        host.step(np.zeros((2, 39)), slice(None))
        expected, path = host.sensed(state), jax.tree.map(lambda values: values[:, 1:], way)
        on_device = State._make(map(jax.numpy.asarray, state))
        draws = device.sense(draws, on_device, path if config.observation_latency[1] else None, key)
        ours = device.sensed(draws, on_device)
        for name in ("hand_qpos", "hand_qvel", "key_qpos", "touch", *EVENTS):
            assert_allclose(getattr(ours, name), getattr(expected, name), atol=2e-6, err_msg=name)
        onsets += np.isfinite(expected.key_onset).sum()
    assert onsets > 20
    assert abs(expected.hand_qpos - state.hand_qpos).max() > 1e-3


def test_noise_is_as_wide_as_it_says_and_the_state_has_none(scene):
    noise = DomainRandomization(joint_noise=0.03, slide_noise=0.002, key_noise=0.05)
    (states,) = played(noise, 0, num_envs=16)
    layout = task_spec(TaskConfig(), scene).observation_layout
    off = np.array(
        [s.info["final_obs"][:, layout["joints"]] - s.info["state"].hand_qpos for s in states]
    )
    slides = np.isin(np.arange(off.shape[-1]), scene.slide_joints)
    turning = [name.split("forearm")[-1] not in ("_tx", "_ty") for name in scene.hand_joint_names]
    assert_allclose(off[..., slides].std(), 0.002, rtol=0.2)
    assert_allclose(off[..., turning].std(), 0.03, rtol=0.05)
    keys = seen(states)[..., layout["key_state"]]
    assert keys.min() == 0.0
    assert 0.05 < keys.max() < 0.5


def test_says_what_makes_no_sense():
    with pytest.raises(CadenzaError, match=r"randomization.mass 1.2 0.8: give the least"):
        played(DomainRandomization(mass=(1.2, 0.8)), 0)


@pytest.mark.slow  # it compiles for a minute
def test_randomized_worlds_move_as_on_the_cpu(scene):
    """Each as the environment of the CPU that begins with the same seed, and not as another one."""
    pytest.importorskip("mujoco_warp")
    servos: Any = {
        "joint_speed": (1.0, 5.0),
        "joint_dead_band": (0.0, 0.01),
        "slide_backlash": (0.0, 0.001),
    }
    senses: Any = {"observation_latency": (0.0, 0.06), "joint_bias": 0.01}
    ranges = DomainRandomization(
        **FACTORS,
        **servos,
        **senses,
        latency=(0.0, 0.12),
        key_sounding=(0.5, 1.0),
        gravity_tilt=0.05,
        mount_offset=0.003,
    )
    config = TaskConfig(randomization=ranges, initial_buffer_time=1.0)
    device = FunctionalPianoTask([ONE_NOTE], config, scene, 3)
    state, rng = device.reset(jax.random.key(0)), np.random.default_rng(0)
    cpu = PianoTask([ONE_NOTE], config, scene, 3)
    seeds = state.info["randomization/seed"].tolist()
    starts = [EpisodeStart(randomization=seed) for seed in seeds]
    cpu.reset(rng.spawn(3), range(3), starts)
    for step in range(12):
        action = np.tile(rng.uniform(-0.2, 0.2, 39), (3, 1)).astype(np.float32)
        state = device.step(state, action)
        result = cpu.step(cpu.spec.scale_action(action))
        ours, theirs = state.info["state"], cpu.state
        assert_allclose(ours.hand_qpos, theirs.hand_qpos, atol=1e-3, err_msg=str(step))
        assert_allclose(ours.key_qpos, theirs.key_qpos, atol=1e-3, err_msg=str(step))
        assert_allclose(state.info["final_obs"], cpu.observation(), atol=0.02)
        assert_allclose(state.reward, result.reward, atol=0.02)
    assert np.ptp(theirs.hand_qpos, axis=0).max() > 0.05
    cpu.close()


@pytest.mark.parametrize("option", ["pixels", "privileged", "num_threads"])
def test_an_option_of_the_other_engine_is_called_so(option):
    with pytest.raises(CadenzaError, match=f"^the engine warp has no {option}: choose"):
        make_vector_env("warp", song=ONE_NOTE, **{option: None})
