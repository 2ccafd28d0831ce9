"""PPO: it learns, its runs go on to the bit, and both engines give it the same rollouts."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental import io_callback
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import melody, train

from cadenza.errors import CadenzaError
from cadenza.learning.actions import ActionMapping
from cadenza.learning.algorithms.ppo.config import PPOConfig
from cadenza.learning.algorithms.ppo.learner import PPO, Normalisation, clipped_objective, gae
from cadenza.learning.collector import Collector
from cadenza.learning.config import TrainingConfig, preset
from cadenza.learning.device_rollouts import DeviceRollouts
from cadenza.learning.env_rollout import EnvRollout
from cadenza.learning.observation import GoalTable, Inputs, ObservationSpec, Observer
from cadenza.learning.on_policy import HostRollouts
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.ranges import ranges_of
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import begin
from cadenza.music.score import Score
from cadenza.scene.config import SceneConfig
from cadenza.sim.mujoco_simulation import MujocoSimulation
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.functional import FunctionalPianoTask
from cadenza.tasks.piano_task import PianoTask

pytestmark = pytest.mark.usefixtures("compiled_once")
SCALE = melody(60, 62, 64, 65, 67, length=0.5)
ONE_HAND = SceneConfig(hands="right", physics="fast")
TINY = PPOConfig(hidden_sizes=(16,), batch_size=8)
CONFIG = TrainingConfig(
    learner=TINY,
    task=TaskConfig(initial_buffer_time=0.1),
    scene=ONE_HAND,
    num_steps=96,
    num_envs=2,
    learning_starts=0,
    train_freq=8,
    gradient_steps=3,
    song_range=True,
    eval_interval=48,
    log_interval=32,
)
SONGS = [melody(60, 64), melody(62, 67, pedal=True)]


def trained(config: TrainingConfig, songs: list[Score], folder: Path, *stops: int) -> RunFolder:
    folder.mkdir()
    run = RunFolder(folder)
    run.begin(config, songs)
    train(config, run, songs, stops)
    return run


def figures(run: RunFolder) -> list[dict[str, Any]]:
    times = {"seconds", "step", "eval/planning_seconds", "eval/playing_seconds"}
    rows = [{n: v for n, v in row.items() if n not in times} for row in run.metrics.rows()]
    return sorted(rows, key=lambda row: "eval_step" in row)


@pytest.mark.parametrize("residual", [pytest.param(False, marks=pytest.mark.slow), True])
def test_a_run_that_is_resumed_ends_as_one_that_was_not(tmp_path, residual):
    config = replace(CONFIG, residual=residual, song_range=not residual)
    songs = SONGS[:1] if residual else SONGS
    runs = [
        trained(config, songs, tmp_path / name, *s) for name, s in (("whole", ()), ("in", (2, 2)))
    ]
    uninterrupted, resumed = (load_policy(run.path / "last") for run in runs)
    for name, weights in uninterrupted.policy.state()[1].items():
        assert_array_equal(weights, resumed.policy.state()[1][name], err_msg=name)
    assert figures(runs[0]) == figures(runs[1])
    assert (runs[0].path / "best").is_dir()


def test_the_saved_policy_is_the_one_that_acts():
    learner = PPO(TINY, Inputs(tuple(range(5)), 5), 3)
    rng = np.random.default_rng(0)
    state = learner.init(0)
    seen = rng.normal(3, 2, (100, 5)).astype(np.float32)
    normalisation = state.normalisation.updated(jnp.asarray(seen))
    params = jax.tree.map(lambda p: p + rng.normal(0, 0.3, p.shape), state.params)
    params["log_std"] = jnp.full(3, -20.0)  # hardly anything is left to chance
    state = state._replace(normalisation=normalisation, params=params)
    expected = np.tanh(learner.act(state, seen, jax.random.key(0)).action)
    assert_allclose(learner.policy(state).mode(seen), expected, atol=0.03)


def test_observations_are_normalised_by_all_that_was_seen():
    seen = np.random.default_rng(0).normal([5, -2], [3, 0.001], (4, 6, 2)).astype(np.float32)
    normalisation = Normalisation(jnp.zeros(()), jnp.zeros(2), jnp.ones(2))
    for part in seen:
        normalisation = normalisation.updated(jnp.asarray(part))
    flat = seen.reshape(-1, 2)
    assert_allclose(normalisation.mean, flat.mean(axis=0), rtol=1e-5)
    assert_allclose(normalisation.std, [flat[:, 0].std(), 0.1], rtol=1e-5)


def test_the_objective_has_no_gain_beyond_the_clip():
    log_ratio = jnp.log(jnp.array([0.5, 1.0, 1.5]))
    gains = clipped_objective(log_ratio, jnp.ones(3), 0.2)
    losses = clipped_objective(log_ratio, -jnp.ones(3), 0.2)
    assert_allclose(gains, [0.5, 1.0, 1.2], rtol=1e-6)
    assert_allclose(losses, [-0.8, -1.0, -1.5], rtol=1e-6)


def test_advantages_are_those_of_td_errors():
    """This holds at lambda 0; no value is carried over the end of an episode."""
    rng = np.random.default_rng(0)
    rewards, values = rng.normal(size=(3, 1, 2)), rng.normal(size=(4, 1, 2))
    ended = np.array([[False], [True], [False]])
    td_errors = rewards + 0.9 * ~ended[..., None] * values[1:] - values[:-1]
    assert_allclose(gae(rewards, values, ended, 0.9, 0.0), td_errors, rtol=1e-5)
    expected = td_errors[0] + 0.9 * 0.5 * td_errors[1]
    assert_allclose(gae(rewards, values, ended, 0.9, 0.5)[0], expected, rtol=1e-5)


def test_a_contextual_bandit_is_solved():
    """The best action is half the observation."""
    config = PPOConfig(hidden_sizes=(32,), batch_size=64, learning_rate=1e-3, target_kl=0.02)
    learner = PPO(config, Inputs((0,), 1), 1)
    state, rng = learner.init(0), np.random.default_rng(0)
    for seed in range(60):
        observation = rng.uniform(-1, 1, (4, 64, 1)).astype(np.float32)
        decisions = [
            learner.act(state, o, k)
            for o, k in zip(observation, jax.random.split(jax.random.key(seed), 4), strict=True)
        ]
        action, log_prob, value = (np.stack(p) for p in zip(*decisions, strict=True))
        reward = -((np.tanh(action) - observation / 2) ** 2)[..., 0]
        ended, zero = np.ones((4, 64), bool), np.zeros((4, 64), np.float32)
        rollout = EnvRollout(observation, action, log_prob, value, reward, ended, zero, zero[0])
        rows = np.concatenate([rng.permutation(256) for _ in range(4)]).reshape(16, 64)
        state, _ = learner.update(state, rollout, rows)
    observation = np.linspace(-1, 1, 9, dtype=np.float32)[:, None]
    assert_allclose(learner.policy(state).mode(observation), observation / 2, atol=0.12)


class Data(NamedTuple):
    """Worlds of the C engine, which have to be reset where they are fresh."""

    hand_qpos: Any
    fresh: Any
    overflow: Any


class MujocoPhysics:
    """The C engine in place of the device's, so that both kinds of worlds have the same states."""

    def __init__(self, scene: Any, num_envs: int, control_timestep: float, *_: Any) -> None:
        self._simulation = MujocoSimulation(scene, num_envs, control_timestep)
        self._state = single_precision(State.at_rest(scene, num_envs))

    def start(self, hand_qpos: Any) -> Data:
        fresh = jnp.ones(len(hand_qpos), bool)
        return Data(jnp.asarray(hand_qpos, jnp.float32), fresh, jnp.zeros(len(hand_qpos), int))

    def step(self, data: Data, ctrl: Any) -> tuple[Data, State]:
        state = io_callback(self._step, self._state, data.hand_qpos, data.fresh, ctrl, ordered=True)
        return data._replace(fresh=jnp.zeros_like(data.fresh)), state

    def _step(self, hand_qpos: Any, fresh: Any, ctrl: Any) -> State:
        reset = np.flatnonzero(fresh)
        self._simulation.reset(reset.tolist(), np.asarray(hand_qpos, np.float64)[reset])
        self._simulation.step(np.asarray(ctrl, np.float64))
        return single_precision(self._simulation.state)


def single_precision(state: State) -> State:
    return State._make(v.astype(np.float32) if v.dtype == float else v for v in state)


class Both(NamedTuple):
    """The same environments on the host and on the device."""

    host: HostRollouts
    device: DeviceRollouts
    learner: PPO


@pytest.fixture
def both():
    config, num_envs = replace(CONFIG.task, n_steps_lookahead=3), 2
    task = PianoTask([SONGS[1]], config, ONE_HAND, num_envs)
    goals, ranges = GoalTable(task.spec, task.tracks), ranges_of(task)
    spec = ObservationSpec.of(task.spec)
    inputs = Inputs(tuple(range(spec.layout["previous_action"].start)), spec.size)
    observer = Observer(task.spec, goals, inputs, ranges=ranges)
    mapping = ActionMapping(task.spec, ranges=ranges)
    rng = np.random.default_rng(0)
    host = HostRollouts(CONFIG, Collector(task, goals, observer, None, mapping, rng), rng)
    on_device = FunctionalPianoTask(
        [SONGS[1]], config, task.scene, num_envs, make_physics=MujocoPhysics
    )
    device = DeviceRollouts(CONFIG, on_device, inputs, ranges, rng, rng)
    host.begin()
    device.begin()
    return Both(host, device, PPO(TINY, inputs, task.spec.action_size))


def test_both_engines_give_the_same_rollouts_and_updates(both):
    """Over ends of episodes, as long as the worlds are in the same states."""
    learner, states = both.learner, []
    for kind in (both.host, both.device):
        state = learner.init(1)
        rows = np.arange(24).reshape(3, 8)
        rollouts = []
        for seed in range(2):
            rollout, finished, metrics = kind.rollout(learner, state, 12, seed)
            state, updates = learner.update(state, rollout, rows)
            totals = np.array([(episode.f1, episode.total_reward) for episode in finished])
            rollouts.append((rollout, totals, metrics, updates))
        states.append((state, rollouts))
    assert_trees_close(*states)
    (_, [(rollout, totals, *_), _]), _ = states
    assert rollout.ended.sum() == len(totals) == 2
    assert (rollout.value_at_end != 0).tolist() == rollout.ended.tolist()


def test_environments_on_a_device_go_on_where_they_were_stopped(both):
    state, device = both.learner.init(1), both.device
    device.rollout(both.learner, state, 3, 0)
    plain, arrays = device.state()
    device.begin()
    device.restore(plain, arrays, [])
    for name, array in device.state()[1].items():
        assert_array_equal(array, arrays[name], err_msg=name)


def assert_trees_close(one: Any, other: Any) -> None:
    """They are equal but for single precision and what contacts make of it."""
    jax.tree.map(lambda a, b: assert_allclose(a, b, rtol=2e-3, atol=2e-3), one, other)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"learning_starts": 5}, "learning_starts 5: this learner learns from rollouts"),
        ({"parallel": True}, "parallel True: this learner learns from rollouts"),
        (
            {"scene": SceneConfig(engine="warp"), "residual": True},
            "engine warp: plans are corrected on CPU cores",
        ),
        (
            vars(replace(preset("fast"), scene=SceneConfig(engine="warp"))),
            "engine warp: .* choose --learner ppo",
        ),
        ({"learner": replace(TINY, clip=0.0)}, "clip 0.0: choose more than 0"),
        ({"residual": True, "song_range": False}, "residual policy corrects the plan of one song"),
    ],
)
def test_what_makes_no_sense_is_refused(options, message, tmp_path):
    with pytest.raises(CadenzaError, match=message):
        begin(replace(CONFIG, **options), SONGS, RunFolder(tmp_path))
    assert not (tmp_path / "run.json").exists()


@pytest.mark.slow  # two minutes
def test_a_scale_is_learnt(tmp_path):
    usual = preset("fast", learner="ppo")
    config = replace(usual, scene=ONE_HAND, num_steps=80_000, eval_interval=20_000)
    run = trained(config, [SCALE], tmp_path / "run")
    f1 = [row["eval/f1"] for row in run.metrics.rows() if "eval/f1" in row]
    assert f1[-1] > f1[0] + 0.4
