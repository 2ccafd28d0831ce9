"""The task as pure functions, value for value against the task that steps, on the same states."""

from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.music.libraries.library import load_score
from cadenza.music.score import Note, Score
from cadenza.scene.config import SceneConfig
from cadenza.sim.protocol import State
from cadenza.tasks.config import TaskConfig
from cadenza.tasks.env import PianoVectorEnv
from cadenza.tasks.piano_task import EpisodeStart, PianoTask

jax = pytest.importorskip("jax")

from jax.experimental import io_callback  # noqa: E402

from cadenza.tasks.functional import FunctionalPianoTask  # noqa: E402

DATA = Path(__file__).parents[1] / "data"
EXACT = {"rtol": 1e-12, "atol": 1e-12}
ONE_NOTE = Score((Note(0.0, 0.2, 60),), title="one note")
CASES = {
    "default": {},
    "terms": {
        "sustain_term": True,
        "forearm_term": True,
        "key_press": "graded",
        "initial_buffer_time": 0.2,
        "n_steps_lookahead": 1,
        "touch": True,
    },
    "published": {"onset_goals": False, "repeats": "published", "initial_buffer_time": 0.0},
    "wrong keys end it": {
        "wrong_press_termination": True,
        "n_steps_lookahead": 0,
        "fingering": "off",
    },
}


class Data(NamedTuple):
    """A physical state without physics."""

    overflow: Any
    path: Any = None


class RecordedPhysics:
    """Worlds that are what the states of another simulation were, one after the other."""

    states: Iterator[State]

    def __init__(self, scene: Any, num_envs: int, *_: Any) -> None:
        self.zeros = State.at_rest(scene, num_envs)

    def start(self, hand_qpos: Any) -> Data:
        return Data(jax.numpy.zeros(len(hand_qpos), int))

    def step(self, data: Data, ctrl: Any) -> tuple[Data, State]:
        return data, io_callback(self._next, single_precision(self.zeros), ordered=True)

    def _next(self) -> State:
        return single_precision(next(self.states))


def single_precision(state: State) -> State:
    return State._make(v.astype(np.float32) if v.dtype == float else v for v in state)


def recorded() -> np.ndarray:
    with np.load(DATA / "episode_d.npz") as file:
        return file["action"][:60]


@pytest.mark.parametrize("options", CASES.values(), ids=CASES)
def test_every_value_of_an_episode(options):
    """The recorded performance, random actions, an action that is no number, and a short song."""
    scores = [load_score("CMajorScaleTwoHands"), ONE_NOTE]
    scene = SceneConfig(touch=options.get("touch", False))
    config = TaskConfig(**{name: value for name, value in options.items() if name != "touch"})
    cpu = PianoTask(scores, config, scene, 4)
    rng, songs = np.random.default_rng(0), np.array([0, 0, 0, 1])
    cpu.reset(rng.spawn(4), range(4), [EpisodeStart(int(song)) for song in songs])
    with jax.enable_x64(True):
        task = FunctionalPianoTask(scores, config, cpu.scene, 4, RecordedPhysics)
        advance, observe = jax.jit(task.advance), jax.jit(task.observation)
        episodes = task.begin(jax.random.key(0))[0]._replace(song=jax.numpy.asarray(songs))
        assert_array_equal(observe(episodes, on_device(cpu.state)), cpu.observation())
        for step, action in enumerate(recorded()):
            ctrl = rng.uniform(cpu.spec.action_low, cpu.spec.action_high, (4, len(action)))
            ctrl[0] = action
            if step == 20:
                ctrl[1, -1] = np.nan
            result = cpu.step(ctrl)
            episodes, ours = advance(episodes, on_device(cpu.state), ctrl)
            assert ours.terms.keys() == result.terms.keys()
            for name, values in result.terms.items():
                assert_allclose(ours.terms[name], values, err_msg=name, **EXACT)
            assert_allclose(ours.reward, result.reward, **EXACT)
            for name in ("terminated", "truncated", "unstable"):
                assert_array_equal(getattr(ours, name), getattr(result, name), err_msg=name)
            assert_array_equal(observe(episodes, on_device(cpu.state)), cpu.observation())
            for env in (0, 2):
                if step < cpu.goals.num_steps[env]:
                    expected = cpu.episode_metrics(env)
                    f1 = [expected[name] for name in ("precision", "recall", "f1")]
                    assert_allclose(episodes.sums[env] / (step + 1), f1, **EXACT)
    cpu.close()


def test_episodes_begin_anew():
    """Against the environments of Gymnasium that are reset in the same step."""
    config = TaskConfig(initial_buffer_time=0.0)
    envs = PianoVectorEnv(ONE_NOTE, 2, autoreset_mode="SameStep", task=config)
    first, _ = envs.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (12, 2, 39)).astype(np.float32)
    states, step = [], envs.task.step

    def watched(*args: Any) -> Any:
        result = step(*args)
        states.append(envs.task.state)
        return result

    envs.task.step = watched
    steps = [envs.step(action) for action in actions]
    RecordedPhysics.states = iter(states)
    task = FunctionalPianoTask([ONE_NOTE], config, envs.task.scene, 2, RecordedPhysics)
    state = task.reset(jax.random.key(0))
    assert_allclose(state.obs, first, atol=1e-6)
    ends = 0
    for action, (obs, reward, terminated, truncated, infos) in zip(actions, steps, strict=True):
        state = task.step(state, action)
        assert_allclose(state.obs, obs, atol=1e-6)
        assert_allclose(state.reward, reward, atol=1e-4)
        assert_array_equal(state.done, terminated | truncated)
        assert_array_equal(state.info["truncation"], truncated)
        for env in np.flatnonzero(truncated):
            assert_allclose(state.info["final_obs"][env], infos["final_obs"][env], atol=1e-6)
            f1 = infos["final_info"]["metrics/f1"][env]
            assert_allclose(state.metrics["f1"][env], f1, atol=1e-6)
            ends += 1
    assert ends >= 4
    envs.close()


def test_songs_of_any_length_one_after_the_other():
    """Against the task of the CPU, whose episodes begin with the songs that were drawn here."""
    lengths = (1, 2, 5, 7, 12)  # control steps
    scores = [Score((Note(0.0, 0.05 * n, 60 + n),), title=str(n)) for n in lengths]
    config = TaskConfig(n_steps_lookahead=3, initial_buffer_time=0.0)
    rng = np.random.default_rng(0)
    num_envs = 6
    cpu = PianoTask(scores, config, None, num_envs)
    states: deque[State] = deque()
    RecordedPhysics.states = iter(states.popleft, None)
    task = FunctionalPianoTask(scores, config, cpu.scene, num_envs, RecordedPhysics)
    state = task.reset(jax.random.key(0))

    def begin(ended: np.ndarray) -> None:
        starts = [EpisodeStart(int(state.info["song"][env])) for env in ended]
        cpu.reset(rng.spawn(len(ended)), ended.tolist(), starts)

    begin(np.arange(num_envs))
    ends = np.zeros(len(scores), int)
    for _ in range(40):
        songs = np.asarray(state.info["song"])
        action = rng.uniform(-1, 1, (num_envs, 39)).astype(np.float32)
        result = cpu.step(cpu.spec.scale_action(action))
        states.append(cpu.state)
        state = task.step(state, action)
        assert_allclose(state.reward, result.reward, atol=1e-4)
        assert_array_equal(state.done, result.terminated | result.truncated)
        assert_array_equal(state.info["truncation"], result.truncated)
        assert_allclose(state.info["final_obs"], cpu.observation(), atol=1e-6)
        for env in (ended := np.flatnonzero(state.done)):
            expected = cpu.episode_metrics(env)
            for name in ("precision", "recall", "f1"):
                assert_allclose(state.metrics[name][env], expected[name], atol=1e-6)
            ends[songs[env]] += 1
        if len(ended):
            begin(ended)
        assert_allclose(state.obs, cpu.observation(), atol=1e-6)
    assert (ends > 0).all()
    cpu.close()


def on_device(state: State) -> State:
    return State._make(jax.numpy.asarray(values) for values in state)


def test_says_what_it_lacks():
    config = TaskConfig(fingering="transport")
    with pytest.raises(CadenzaError, match="no fingering transport"):
        FunctionalPianoTask([ONE_NOTE], config, None, 1, RecordedPhysics)


def test_episodes_draw_tempo_and_pitch():
    """Of each song as many variations, within the ranges, and none without them."""
    scores = [ONE_NOTE, Score((Note(0.0, 4.0, 72),), title="a long one")]
    config = TaskConfig(random_pitch_shift=3, random_stretch=0.5, initial_buffer_time=0.0)
    task = FunctionalPianoTask(scores, config, None, 64, StillPhysics)
    episodes, _ = task.begin(jax.random.key(0))
    state, songs = task.reset(jax.random.key(0)), np.asarray(episodes.song)
    goal, steps = np.asarray(task.songs.goal)[songs], np.asarray(task.songs.num_steps)[songs]
    pitches = goal[..., :-1].any(axis=1).argmax(axis=1) + task.scene.keyboard.pitches[0]
    is_long = pitches > 66
    for drawn, around in ((pitches[~is_long], 60), (pitches[is_long], 72)):
        assert set(drawn) <= set(range(around - 3, around + 4))
        assert len(set(drawn)) >= 5
    assert 40 <= steps[is_long].min() < 60 < 100 < steps[is_long].max() <= 122
    assert set(np.asarray(state.info["song"]).tolist()) == {0, 1}


def test_terms_of_the_reward_of_ones_own():
    """They are compiled; one of another shape is refused."""
    terms = {"still": lambda outcome: -abs(outcome.ctrl[:, 0])}
    task = FunctionalPianoTask([ONE_NOTE], None, None, 2, StillPhysics, terms)
    state = task.step(task.reset(jax.random.key(0)), np.stack([np.zeros(39), np.ones(39)]))
    high = task.spec.scale_action(np.ones(39))[0]
    assert_allclose(state.metrics["reward/still"][1], -abs(high), rtol=1e-6)
    plain = FunctionalPianoTask([ONE_NOTE], None, None, 2, StillPhysics)
    without = plain.step(plain.reset(jax.random.key(0)), np.stack([np.zeros(39), np.ones(39)]))
    assert_allclose(
        state.reward - without.reward, state.metrics["reward/still"], rtol=1e-5, atol=1e-6
    )
    wrong = {"one": lambda outcome: outcome.ctrl.sum()}
    task = FunctionalPianoTask([ONE_NOTE], None, None, 2, StillPhysics, wrong)
    with pytest.raises(CadenzaError, match=r"reward term 'one' returned values of shape \(\)"):
        task.reset(jax.random.key(0))


def test_gymnasium_makes_environments_on_the_device():
    """Random actions as another library's array; the observations of the first as of the CPU's."""
    options: dict[str, Any] = {"song": ONE_NOTE, "num_envs": 2, "initial_buffer_time": 0.0}
    envs = gym.make_vec("cadenza/Piano-v0", engine="warp", make_physics=StillPhysics, **options)
    on_cpu = gym.make_vec("cadenza/Piano-v0", **options)
    observation, _ = envs.reset(seed=1)
    assert_allclose(np.from_dlpack(observation), on_cpu.reset(seed=1)[0], atol=1e-6)
    assert envs.observation_space == on_cpu.observation_space
    assert envs.action_space == on_cpu.action_space
    assert envs.observation_space.contains(np.asarray(observation))
    lengths = [envs.step(jax.numpy.zeros((2, 39)))[3].all() for _ in range(10)]
    assert lengths == [False, False, False, False, True] * 2
    with pytest.raises(CadenzaError, match=r"actions of shape \(3, 39\): give \(2, 39\)"):
        envs.step(np.zeros((3, 39)))
    with pytest.raises(CadenzaError, match="engine 'cuda': choose from c, warp"):
        gym.make_vec("cadenza/Piano-v0", engine="cuda", **options)


def test_the_first_unstable_simulation_is_told_and_all_are_counted(caplog):
    envs = gym.make_vec("cadenza/Piano-v0", 3, song=ONE_NOTE, engine="warp", make_physics=Failing)
    envs.reset(seed=0)
    counts = []
    for _ in range(3):
        *_, infos = envs.step(np.zeros((3, 39), np.float32))
        counts.append((int(infos["unstable_count"]), int(infos["overflow_count"])))
    jax.effects_barrier()
    assert counts == [(2, 1), (4, 2), (6, 3)]
    (message,) = caplog.messages
    assert message.startswith("simulations became unstable: 2 in this step, 1 of them without room")
    envs.reset(seed=0)
    *_, infos = envs.step(np.zeros((3, 39), np.float32))
    assert infos["unstable_count"] == 2


class StillPhysics(RecordedPhysics):
    """Nothing moves."""

    def step(self, data: Data, ctrl: Any) -> tuple[Data, State]:
        return data, jax.tree.map(jax.numpy.asarray, single_precision(self.zeros))


class Failing(StillPhysics):
    """All simulations but the last become unstable in each step, the first by lost contacts."""

    def step(self, data: Data, ctrl: Any) -> tuple[Data, State]:
        _, state = super().step(data, ctrl)
        unstable = jax.numpy.asarray([True, True, False])
        return Data(jax.numpy.asarray([1, 0, 0])), state._replace(unstable=unstable)
