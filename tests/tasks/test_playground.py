"""The task as MuJoCo Playground and brax know environments, on a piano that plays itself."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from cadenza.errors import CadenzaError
from cadenza.music.score import Note, Score
from cadenza.sim.protocol import State

jax = pytest.importorskip("jax")
import jax.numpy as jnp  # noqa: E402

from cadenza.tasks.playground import PlaygroundPiano, WorldState  # noqa: E402

UP = Score(tuple(Note(i / 5, (i + 1) / 5, 60 + i) for i in range(4)), title="Up")
ONE = Score((Note(0.0, 0.2, 72),), title="One")


class Angles(NamedTuple):
    """A physical state without motion."""

    qpos: Any
    overflow: Any


class Obedient:
    """Keys that are at once where their motors want them."""

    def __init__(self, scene: Any, num_envs: int, *_: Any) -> None:
        self.travel, self.num_envs = scene.keyboard.travel, num_envs
        self.zeros = State.at_rest(scene, num_envs)
        self.high = jnp.asarray(scene.action_high[:-1], jnp.float32)

    def start(self, hand_qpos: Any) -> Angles:
        return Angles(
            jnp.zeros((len(hand_qpos), len(self.high))), jnp.zeros(len(hand_qpos), jnp.int32)
        )

    def step(self, data: Angles, ctrl: Any) -> tuple[Angles, State]:
        qpos = jnp.asarray(ctrl / self.high * self.travel, jnp.float32)
        state = jax.tree.map(jnp.asarray, self.zeros)._replace(key_qpos=qpos)
        return data._replace(qpos=qpos), state


@pytest.fixture(scope="module")
def env():
    options = {"hands": "none", "n_steps_lookahead": 0, "initial_buffer_time": 0.0}
    return PlaygroundPiano([UP, ONE], Obedient, **options)


def right_keys(obs: Any) -> Any:
    """Actions that press the keys of the goal, which the observation begins with."""
    return obs[..., :89] * 2 - 1


def worlds(env: PlaygroundPiano, count: int) -> WorldState:
    return jax.jit(jax.vmap(env.reset))(jax.random.split(jax.random.PRNGKey(0), count))


def test_has_the_fields_that_learners_read(env):
    state = jax.jit(env.reset)(jax.random.key(0))
    assert state.obs.shape == (env.observation_size,)
    assert state.done.dtype == np.float32
    assert env.unwrapped is env
    assert (env.action_size, env.dt, env.mj_model.nu) == (89, 0.05, 88)
    assert env.episode_length == max(t.goals.num_steps for t in env.task.tracks)
    put_back = state.replace(pipeline_state="there", done=state.done + 1)
    assert (put_back.data, put_back.pipeline_state, float(put_back.done)) == ("there", "there", 1)


def test_worlds_that_are_mapped_are_those_one_by_one(env):
    """And those of the batch that they are stepped as, song by song."""
    state, step, step_alone = worlds(env, 8), jax.jit(jax.vmap(env.step)), jax.jit(env.step)
    alone = [jax.tree.map(lambda values, i=i: values[i], state) for i in range(8)]
    assert set(np.asarray(state.info["song"])) == {0, 1}
    returns = 0.0
    for _ in range(2):
        action = right_keys(state.obs).at[0].set(-1.0)
        state = step(state, action)
        alone = [step_alone(each, action[i]) for i, each in enumerate(alone)]
        for name in ("obs", "reward", "done", "metrics"):
            stacked = jax.tree.map(
                lambda *rows: jnp.stack(rows), *(getattr(s, name) for s in alone)
            )
            jax.tree.map(partial(assert_allclose, rtol=1e-6), getattr(state, name), stacked)
        returns += np.asarray(state.reward)
    assert returns[0] < returns[1:].min()


def test_an_episode_ends_with_its_song_and_says_how_it_was(env):
    state, step = worlds(env, 4), jax.jit(jax.vmap(env.step))
    length = np.array([track.goals.num_steps for track in env.task.tracks])[state.info["song"]]
    sums, ended = np.zeros(4), np.zeros(4)
    for count in range(1, env.episode_length + 1):
        state = step(state, right_keys(state.obs))
        running = ended == 0
        assert_array_equal(state.done[running], length[running] == count)
        sums[running] += np.asarray(state.metrics["f1"])[running]
        ended += np.asarray(state.done)
    assert_allclose(sums, 1.0)


def test_steps_within_scans_and_what_wrappers_add_stays(env):
    state = worlds(env, 3)
    state.info["steps"], state.metrics["reward"] = jnp.arange(3), jnp.ones(3)

    @jax.jit
    def rollout(state: WorldState) -> tuple[WorldState, Any]:
        def one(state: WorldState, _: Any) -> tuple[WorldState, Any]:
            state = jax.vmap(env.step)(state, right_keys(state.obs))
            return state, state.reward

        return jax.lax.scan(one, state, length=4)

    state, rewards = rollout(state)
    assert rewards.shape == (4, 3)
    assert_array_equal(state.info["steps"], np.arange(3))
    assert_array_equal(state.metrics["reward"], np.ones(3))


def test_renders_a_world_but_no_batch(env):
    state = worlds(env, 2)
    with pytest.raises(CadenzaError, match="states of 2 worlds"):
        env.render([state])
    one = jax.tree.map(lambda values: values[0], state)
    pictures = env.render([one, env.step(one, right_keys(one.obs))], height=60, width=80)
    assert [picture.shape for picture in pictures] == [(60, 80, 3)] * 2
    assert (pictures[0] != pictures[1]).any()


@pytest.mark.slow
def test_brax_learns_on_it(env):
    """By its PPO with its own wrappers, as the example does."""
    ppo = pytest.importorskip("brax.training.agents.ppo.train")
    evaluations: list[dict[str, float]] = []
    ppo.train(
        env,
        num_timesteps=60_000,
        episode_length=env.episode_length,
        num_envs=64,
        num_eval_envs=16,
        num_evals=2,
        batch_size=64,
        num_minibatches=4,
        unroll_length=8,
        num_updates_per_batch=4,
        normalize_observations=True,
        discounting=0.8,
        entropy_cost=1e-3,
        learning_rate=1e-3,
        progress_fn=lambda _, metrics: evaluations.append(metrics),
    )
    assert len(evaluations) == 2
    for each in evaluations:
        assert np.isfinite(each["eval/episode_reward"])
        assert 0 <= each["eval/episode_f1"] <= 1
    before, after = (each["eval/episode_reward"] for each in evaluations)
    assert after > before + 1.0
