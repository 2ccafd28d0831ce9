"""One update after the other against a plain reference, and what learning must come to."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import random_batches
from scipy.stats import norm

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.learner import DroQ, DroQState, actor_weights, adam
from cadenza.learning.algorithms.on_jax import learning_rate_schedule, to_arrays
from cadenza.learning.observation import Inputs
from cadenza.learning.policy import Perceptron
from cadenza.learning.replay_buffer import Batch

INPUTS, ACTIONS, BATCH = 10, 3, 8
ALL = Inputs(tuple(range(INPUTS)), INPUTS)
CONFIG = DroQConfig(
    hidden_sizes=(16,),
    dropout=0.2,
    batch_size=BATCH,
    actor_learning_rate=3e-3,
    critic_learning_rate=3e-3,
    temperature_learning_rate=3e-3,
    tau=0.05,
    policy_delay=2,
    actor_ema=0.2,
)


@pytest.fixture(scope="module")
def learner():
    """A learner with dropout and layer normalisation, which is compiled once."""
    return DroQ(CONFIG, ALL, ACTIONS)


def batches(number: int, seed: int = 0) -> Batch:
    return random_batches(np.random.default_rng(seed), (number, BATCH), INPUTS, ACTIONS)


def numbers(state: DroQState) -> dict[str, np.ndarray]:
    """A copy: an update uses its state up."""
    return {name: array.copy() for name, array in to_arrays(state).items()}


def part(batch: Batch, i: int) -> Batch:
    return Batch(*(values[i : i + 1] for values in batch))


# The reference: SAC (Haarnoja et al. 2018, second version) in numpy, as one would write it down,
# with gradients by differences


def flat(params: Any) -> np.ndarray:
    return np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(params)]).astype(np.float64)


def unflat(vector: np.ndarray, like: Any) -> Any:
    leaves, structure = jax.tree.flatten(like)
    pieces = np.split(vector, np.cumsum([leaf.size for leaf in leaves])[:-1])
    return structure.unflatten(
        [p.reshape(leaf.shape) for p, leaf in zip(pieces, leaves, strict=True)]
    )


def linear(layer: Any, x: np.ndarray) -> np.ndarray:
    return x @ layer["kernel"] + layer["bias"]


def perceptron(params: Any, x: np.ndarray) -> np.ndarray:
    for i in range(len(params["HiddenLayers_0"])):
        x = np.maximum(linear(params["HiddenLayers_0"][f"hidden_{i}"], x), 0)
    return x


def value(critic: Any, observation: np.ndarray, action: np.ndarray) -> np.ndarray:
    x = np.concatenate([observation, action], axis=1)
    return linear(critic["value"], perceptron(critic, x))[:, 0]


def act(actor: Any, observation: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Actions and the logarithms of their densities."""
    x = perceptron(actor, observation)
    std = np.exp(np.clip(linear(actor["log_std"], x), -20, 2))
    action = np.tanh(linear(actor["mean"], x) + std * noise)
    return action, np.log(norm.pdf(noise) / std / (1 - action**2)).sum(axis=1)


class Adam:
    """A minimiser of a function of a vector (Kingma & Ba 2015, algorithm 1)."""

    def __init__(self, start: Any, rate: float) -> None:
        self.like, self.x, self.rate = start, flat(start), rate
        self.mean, self.square, self.steps = 0.0 * self.x, 0.0 * self.x, 0

    @property
    def params(self) -> Any:
        return unflat(self.x, self.like)

    def step(self, loss: Callable[[Any], float]) -> None:
        steps = 1e-6 * np.eye(len(self.x))
        up, down = (
            np.array([loss(unflat(self.x + sign * step, self.like)) for step in steps])
            for sign in (1, -1)
        )
        gradient = (up - down) / 2e-6
        self.steps += 1
        self.mean = 0.9 * self.mean + 0.1 * gradient
        self.square = 0.999 * self.square + 0.001 * gradient**2
        mean, square = self.mean / (1 - 0.9**self.steps), self.square / (1 - 0.999**self.steps)
        self.x = self.x - self.rate * mean / (np.sqrt(square) + 1e-8)


class Reference:
    """The reference, from a `DroQState` on."""

    def __init__(self, state: DroQState, config: DroQConfig, noise: np.ndarray) -> None:
        self.config, self.noise, self.updates = config, noise, 0
        self.actor = Adam(state.actor, config.actor_learning_rate)
        self.critics = [Adam(critic, config.critic_learning_rate) for critic in state.critics]
        self.targets = [flat(target) for target in state.target_critics]
        self.log_alpha = Adam(state.log_alpha, config.temperature_learning_rate)

    def update(self, batch: Batch) -> dict[str, Any]:
        config, temperature = self.config, np.exp(self.log_alpha.x[0])
        action, log_prob = act(self.actor.params, batch.next_observation, self.noise)
        least = np.min(
            [
                value(unflat(target, critic.like), batch.next_observation, action)
                for target, critic in zip(self.targets, self.critics, strict=True)
            ],
            axis=0,
        )
        target = batch.reward + config.discount * batch.discount * (least - temperature * log_prob)

        def loss(critic: Any) -> float:
            return ((value(critic, batch.observation, batch.action) - target) ** 2).mean()

        values = [value(c.params, batch.observation, batch.action) for c in self.critics]
        figures = {
            "critic_loss": np.mean([loss(critic.params) for critic in self.critics]),
            "value": np.mean(values),
        }
        for i, critic in enumerate(self.critics):
            critic.step(lambda params: loss(params) / len(self.critics))
            self.targets[i] += config.tau * (critic.x - self.targets[i])
        if self.updates % config.policy_delay == 0:
            figures |= self._update_actor(batch, temperature)
        self.updates += 1
        return figures | {"temperature": np.exp(self.log_alpha.x[0])}

    def _update_actor(self, batch: Batch, temperature: float) -> dict[str, Any]:
        def loss(actor: Any) -> float:
            action, log_prob = act(actor, batch.observation, self.noise)
            values = [value(c.params, batch.observation, action) for c in self.critics]
            return (temperature * log_prob - np.mean(values, axis=0)).mean()

        entropy = -act(self.actor.params, batch.observation, self.noise)[1].mean()
        figures = {"actor_loss": loss(self.actor.params), "entropy": entropy}
        self.actor.step(loss)
        self.log_alpha.step(lambda x: float(np.exp(x) * (entropy + ACTIONS / 2)))
        return figures


@pytest.fixture
def noise(monkeypatch):
    """The same random numbers for learner and reference, however keys are split."""
    noise = np.random.default_rng(5).standard_normal((BATCH, ACTIONS)).astype(np.float32)
    monkeypatch.setattr(jax.random, "normal", lambda *_, **__: jnp.asarray(noise))
    return noise


def test_updates_are_those_of_soft_actor_critic(noise):
    config = replace(CONFIG, dropout=0.0, layer_norm=False, initial_temperature=0.3, discount=0.9)
    learner = DroQ(config, ALL, ACTIONS)
    state, batch = learner.init(0), batches(4)
    reference = Reference(state, config, noise)
    state, figures = learner.update(state, batch)
    for i in range(4):
        expected = reference.update(Batch(*(values[i] for values in batch)))
        assert ("actor_loss" in expected) == np.isfinite(figures["actor_loss"][i])
        for name, number in expected.items():
            assert_allclose(figures[name][i], number, rtol=1e-4, atol=1e-5, err_msg=name)
    # Adam's steps are this long; of a gradient near zero they keep few digits.
    tolerance = {"atol": 0.05 * config.actor_learning_rate, "rtol": 0}
    assert_allclose(flat(state.actor), reference.actor.x, **tolerance)
    assert_allclose(flat(state.log_alpha), reference.log_alpha.x, **tolerance)
    for i, critic in enumerate(reference.critics):
        assert_allclose(flat(state.critics[i]), critic.x, **tolerance)
        assert_allclose(flat(state.target_critics[i]), reference.targets[i], **tolerance)


# What holds for this learner


def test_targets_begin_as_the_critics_and_follow_them(learner):
    """They follow by a share `tau` at every update, as the averaged actor follows the actor."""
    state, batch = learner.init(0), batches(4)
    targets, averaged = flat(state.target_critics), flat(state.actor_ema)
    assert_array_equal(targets, flat(state.critics))
    assert_array_equal(averaged, flat(state.actor))
    assert (flat(state.critics[0]) != flat(state.critics[1])).any()
    for i in range(4):
        state, _ = learner.update(state, part(batch, i))
        targets += 0.05 * (flat(state.critics) - targets)
        assert_allclose(flat(state.target_critics), targets, atol=1e-6)
        if i % 2 == 0:
            averaged += 0.2 * (flat(state.actor) - averaged)
        assert_allclose(flat(state.actor_ema), averaged, atol=1e-6)


def test_learning_rates_have_fallen_when_the_run_ends():
    """This also holds for what is updated only now and then."""
    config = replace(CONFIG, policy_delay=2, final_learning_rate_fraction=0.1)
    for every, updates in (1, 8), (2, 4):
        optimizer = adam(config, 1.0, ((0, 8),), every)
        state, rates = optimizer.init(jnp.zeros(1)), []
        for _ in range(updates + 1):
            change, state = optimizer.update(jnp.ones(1), state)
            rates.append(-float(change[0]))  # as long as the gradient stays the same
        assert_allclose(rates, np.linspace(1.0, 0.1, updates + 1), rtol=1e-3)


def test_the_actor_and_the_temperature_rest_in_between(learner):
    """The policy delay is 2."""
    state, changed = learner.init(0), []
    for i in range(4):
        before = numbers(state)
        state, _ = learner.update(state, part(batches(4), i))
        parts = {name: name[1:].partition("[")[0] for name in before}
        changed.append(
            {parts[n] for n, array in numbers(state).items() if (before[n] != array).any()}
        )
    always = {"key", "updates", "critics", "target_critics", "critic_opt_state"}
    actor = {"actor", "actor_ema", "actor_opt_state"}
    actor |= {"log_alpha", "alpha_opt_state"}
    assert changed == [always | actor, always] * 2


def test_many_updates_at_once_are_those_one_by_one(learner):
    batch = batches(6)
    together, figures = learner.update(learner.init(1), batch)
    single, each = learner.init(1), []
    for i in range(6):
        single, shown = learner.update(single, part(batch, i))
        each.append(shown)
    ours, theirs = numbers(together), numbers(single)
    assert int(together.updates) == 6
    for name in ours:
        assert_allclose(ours[name], theirs[name], rtol=1e-4, atol=1e-5, err_msg=name)
    for name, values in figures.items():
        expected = np.concatenate([shown[name] for shown in each])
        assert_allclose(values, expected, rtol=1e-4, atol=1e-5, err_msg=name)


PROGRAM = """
import os, sys
os.sched_setaffinity(0, set(map(int, sys.argv[1:])))
import hashlib
import numpy as np
from cadenza.learning.config import preset
from cadenza.learning.algorithms.on_jax import learning_rate_schedule, to_arrays
from cadenza.learning.observation import Inputs
from cadenza.learning.replay_buffer import Batch
rng, size = np.random.default_rng(0), (3, 256)
def draw(*shape):
    return rng.standard_normal((*size, *shape), np.float32)
observation, action, following = draw(284), np.tanh(draw(39)), draw(284)
batches = Batch(observation, action, draw(), np.ones(size, np.float32), following)
learner = preset("fast", residual=True).learner.make(Inputs(tuple(range(284)), 284), 39)
state, _ = learner.update(learner.init(0), batches)
for name, array in to_arrays(state).items():
    print(name, hashlib.sha256(array.tobytes()).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_any_number_of_cores_gives_the_same_bits():
    """Networks and batches of the real sizes: small ones XLA does not divide among threads."""
    cores = sorted(map(str, os.sched_getaffinity(0)))
    if len(cores) == 1:
        pytest.skip("there is only one core")
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    printed = [
        subprocess.run(
            [sys.executable, "-c", PROGRAM, *some],
            capture_output=True,
            text=True,
            check=True,
            env=env,  # compiled for these cores, and with all optimizations
        ).stdout
        for some in (cores[:1], cores)
    ]
    assert printed[0].splitlines() == printed[1].splitlines()
    assert len(printed[0].splitlines()) > 50


def test_target_entropy_is_minus_half_the_number_of_actions_by_default():
    assert DroQ(DroQConfig(), ALL, 39).target_entropy == -19.5
    assert DroQ(DroQConfig(target_entropy=-3.0), ALL, 39).target_entropy == -3.0


def test_learns_to_do_what_is_rewarded(learner):
    """Episodes of one step; the reward falls with the square of the distance from a target."""
    rng = np.random.default_rng(0)
    state = learner.init(0)
    for _ in range(300):
        batch = random_batches(rng, (6, BATCH), INPUTS, ACTIONS)
        action = rng.uniform(-1, 1, (6, BATCH, ACTIONS)).astype(np.float32)
        target = np.array([0.6, -0.5, 0.0]) * np.sign(batch.observation[..., :1])
        reward = 10 - 10 * ((action - target) ** 2).sum(axis=-1)
        batch = batch._replace(
            action=action, reward=reward.astype(np.float32), discount=np.zeros_like(batch.discount)
        )
        state, _ = learner.update(state, batch)
    observation = rng.standard_normal((200, INPUTS)).astype(np.float32)
    best = Perceptron(actor_weights(state.actor), "relu", (-20, 2)).mode(observation)
    clear = np.abs(observation[:, 0]) > 0.5
    target = np.array([0.6, -0.5, 0.0]) * np.sign(observation[:, :1])
    assert np.abs(best - target)[clear].mean() < 0.2


# Inputs that are always zero


def test_inputs_that_are_always_zero_can_be_left_out(learner):
    """Nothing changes, with dropout either: its masks do not look at the inputs.

    The first layer of the critics has more inputs that count, the actions, after those.
    """
    kept = (0, 2, 3, 7)
    some = DroQ(CONFIG, Inputs(kept, INPUTS), ACTIONS)
    batch = batches(6)
    zero = np.setdiff1d(np.arange(INPUTS), kept)
    for observation in (batch.observation, batch.next_observation):
        observation[..., zero] = 0
    less = batch._replace(
        observation=batch.observation[..., kept], next_observation=batch.next_observation[..., kept]
    )
    state, fewer = learner.init(0), some.init(0)
    unused = np.asarray(state.actor["HiddenLayers_0"]["hidden_0"]["kernel"])[zero].copy()
    for _ in range(3):
        state, figures = learner.update(state, batch)
        fewer, figures_fewer = some.update(fewer, less)
        for name, values in figures.items():
            assert_allclose(values, figures_fewer[name], rtol=2e-4, atol=1e-5, err_msg=name)
    ours, theirs = actor_weights(state.actor), actor_weights(fewer.actor)
    assert_array_equal(ours["hidden_0/kernel"][zero], unused)
    ours["hidden_0/kernel"] = ours["hidden_0/kernel"][list(kept)]
    for name, array in ours.items():
        assert_allclose(array, theirs[name], atol=1e-4, err_msg=name)
    shown = np.asarray(batch.observation[0])
    best = Perceptron(actor_weights(state.actor), "relu", (-20, 2)).mode(shown)
    assert_allclose(Perceptron(theirs, "relu", (-20, 2)).mode(shown[:, kept]), best, atol=1e-4)


# Learning rates that fall


def rates(last: float, ends: tuple[tuple[int, int], ...], updates: int) -> np.ndarray:
    schedule = learning_rate_schedule(2e-3, last, ends)
    return np.array([schedule(update) for update in range(updates)])  # type: ignore[operator]


def test_learning_rates_fall_evenly_to_the_end():
    expected = 2e-3 * np.interp(np.arange(150), [0, 100], [1, 0.1])
    assert_allclose(rates(0.1, ((0, 100),), 150), expected, rtol=1e-5)
    assert learning_rate_schedule(2e-3, 1.0, ((0, 100),)) == 2e-3


@pytest.mark.parametrize(
    ("ends", "corners"),
    [
        (((0, 100), (60, 200)), [(60, 0.46), (200, 0.1)]),
        (((0, 100), (100, 200)), [(100, 0.1), (200, 0.1)]),
        (((0, 100), (50, 80)), [(50, 0.55), (80, 0.1)]),
        (((0, 100), (60, 200), (130, 250)), [(60, 0.46), (130, 0.28), (250, 0.1)]),
        (((0, 0), (40, 90)), [(1, 0.1), (90, 0.1)]),
    ],
)
def test_another_end_makes_no_jump_of_the_learning_rates(ends, corners):
    """They go on from what they are."""
    x, y = zip((0, 1.0), *corners, strict=True)
    fall = rates(0.1, ends, 300)
    if ends[0][1]:
        assert_allclose(fall, 2e-3 * np.interp(np.arange(300), x, y), rtol=1e-5)
    assert np.diff(fall[1:]).max() < 1e-9
    assert fall[-1] == pytest.approx(2e-4)


# Threads


def test_says_with_how_many_threads_jax_was_started():
    """This also holds where JAX was started elsewhere and the learner cannot choose any more."""
    program = """
import os, sys
os.environ["NPROC"] = "3"
import jax
if sys.argv[1] == "before":
    jax.devices()
from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.observation import Inputs
print(DroQConfig().make(Inputs((0, 1), 2), 1).num_threads)
"""
    for when, threads in (("before", "3"), ("not", "2")):
        done = subprocess.run(
            [sys.executable, "-c", program, when], capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() in (threads, "None"), when
