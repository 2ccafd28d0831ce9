"""The networks against plain numpy, and what their random parts must be like."""

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import random_params
from scipy.stats import binomtest

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.networks import Actor, Critic, Dropout, FirstLayer
from cadenza.learning.observation import Inputs

ALL = Inputs(tuple(range(12)), 12)
SOME = Inputs((0, 3, 4, 9, 11), 12)


@partial(jax.jit, static_argnums=0)
def _drop(rate: float, x: Any, seed: int) -> Any:
    return Dropout(rate).apply({}, x, rngs={"dropout": jax.random.key(seed)})


def dropped(rate: float, x: Any, seed: int = 0) -> np.ndarray:
    return np.asarray(_drop(rate, x, seed))


# Dropout


@pytest.mark.parametrize("rate", [0.01, 0.1, 0.5])
def test_dropout_drops_its_share_and_scales_up_the_rest(rate):
    x = np.random.default_rng(0).uniform(1, 2, (2, 256, 256)).astype(np.float32)
    out = dropped(rate, x)
    zeros = int((out == 0).sum())
    assert binomtest(zeros, x.size, rate).pvalue > 1e-4
    assert_allclose(out[out != 0], x[out != 0] / (1 - rate), rtol=1e-6)


@pytest.mark.parametrize("rate", [0.01, 0.1, 0.5])
def test_dropout_scatters_what_it_drops(rate):
    """Rows, columns and blocks lose numbers that vary as those of independent coins do."""
    fell = np.array([dropped(rate, np.ones((256, 256), np.float32), s) == 0 for s in range(8)])
    blocks = fell.reshape(8, 16, 16, 16, 16).transpose(0, 1, 3, 2, 4).reshape(8, 256, 256)
    for parts in (fell, fell.transpose(0, 2, 1), blocks):
        lost = parts.sum(axis=2).ravel()
        dispersion = lost.var() / (256 * rate * (1 - rate))
        assert abs(dispersion - 1) < 6 * np.sqrt(2 / len(lost))


def test_dropout_of_the_same_entry_is_fair_over_keys():
    fell = np.array([dropped(0.5, np.ones(32, np.float32), seed) == 0 for seed in range(400)])
    assert np.abs(fell.mean(axis=0) - 0.5).max() < 5 * np.sqrt(0.25 / 400)
    correlation = np.corrcoef(fell.T) - np.eye(32)
    assert np.abs(correlation).max() < 5 / np.sqrt(400)


# Layers


def test_first_layer_with_fewer_inputs_begins_as_the_same_layer():
    """Nothing changes where what is left out is zero."""
    x = np.zeros((7, 12), np.float32)
    x[:, SOME.kept] = np.random.default_rng(0).standard_normal((7, 5))
    full, less = FirstLayer(8, ALL), FirstLayer(8, SOME)
    weights, fewer = full.init(jax.random.key(1), x), less.init(jax.random.key(1), x[:, SOME.kept])
    assert fewer["params"]["kernel"].shape == (5, 8)
    assert_array_equal(
        fewer["params"]["kernel"], np.asarray(weights["params"]["kernel"])[list(SOME.kept)]
    )
    assert_allclose(
        less.apply(fewer, x[:, SOME.kept]), full.apply(weights, x), rtol=1e-6, atol=1e-6
    )


def test_first_layer_begins_by_xavier():
    """Glorot & Bengio 2010: uniform up to the square root of 6 over inputs and outputs."""
    inputs = Inputs(tuple(range(0, 1000, 2)), 1000)
    params = FirstLayer(256, inputs).init(jax.random.key(0), np.zeros((1, 500)))["params"]
    most = np.sqrt(6 / (1000 + 256))
    kernel = np.asarray(params["kernel"])
    assert 0.999 * most < np.abs(kernel).max() <= most
    assert_allclose(kernel.std(), most / np.sqrt(3), rtol=0.01)
    assert not np.asarray(params["bias"]).any()


def relu(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0)


def gelu(x: np.ndarray) -> np.ndarray:
    return x / 2 * (1 + np.tanh(np.sqrt(2 / np.pi) * (x + 0.044715 * x**3)))


def dense(layer: dict[str, Any], x: np.ndarray) -> np.ndarray:
    return x @ np.asarray(layer["kernel"], np.float64) + np.asarray(layer["bias"], np.float64)


@pytest.mark.parametrize("activation", ["relu", "gelu"])
def test_critic_is_a_perceptron_with_layer_normalisation(activation):
    rng = np.random.default_rng(0)
    observation = rng.standard_normal((6, 12)).astype(np.float32)
    action = rng.standard_normal((6, 2)).astype(np.float32)
    config = DroQConfig(hidden_sizes=(9, 7), dropout=0.0, activation=activation)
    critic = Critic(config, Inputs(tuple(range(14)), 14))
    params = random_params(critic, rng, observation, action)
    x = np.concatenate([observation, action], axis=1).astype(np.float64)
    layers = params["HiddenLayers_0"]
    for i in range(2):
        x = dense(layers[f"hidden_{i}"], x)
        norm = layers[f"LayerNorm_{i}"]
        x = (x - x.mean(axis=1, keepdims=True)) / np.sqrt(x.var(axis=1, keepdims=True) + 1e-6)
        x = x * np.asarray(norm["scale"]) + np.asarray(norm["bias"])
        x = relu(x) if activation == "relu" else gelu(x)
    expected = dense(params["value"], x)[:, 0]
    assert_allclose(
        jax.jit(critic.apply)({"params": params}, observation, action),
        expected,
        rtol=1e-4,
        atol=1e-5,
    )


def test_critic_drops_before_it_normalises():
    """DroQ, section 4: dropout, layer normalisation, activation. So sums stay normalised."""
    config = DroQConfig(hidden_sizes=(64,), dropout=0.5)
    critic = Critic(config, Inputs(tuple(range(14)), 14))
    both = (np.ones((5, 12), np.float32), np.ones((5, 2), np.float32))
    params = random_params(critic, np.random.default_rng(0), *both)
    watched = partial(critic.apply, capture_intermediates=True, mutable=["intermediates"])
    values, seen = jax.jit(watched)({"params": params}, *both, rngs={"dropout": jax.random.key(2)})
    normal = np.asarray(seen["intermediates"]["HiddenLayers_0"]["LayerNorm_0"]["__call__"][0])
    norm = params["HiddenLayers_0"]["LayerNorm_0"]
    normal = (normal - norm["bias"]) / norm["scale"]
    assert_allclose(normal.mean(axis=1), 0, atol=1e-4)
    assert_allclose(normal.std(axis=1), 1, atol=1e-3)
    # Rows of the same input differ by their dropout only.
    assert len(set(np.asarray(values).tolist())) == 5


def test_actor_has_neither_dropout_nor_normalisation_and_limits_its_deviation():
    rng = np.random.default_rng(0)
    observation = 5 * rng.standard_normal((50, 12)).astype(np.float32)
    config = DroQConfig(hidden_sizes=(9, 7), dropout=0.5, log_std_min=-0.5, log_std_max=0.25)
    actor = Actor(config, ALL, 3)
    params = random_params(actor, rng, observation)
    x = observation.astype(np.float64)
    for i in range(2):
        x = relu(dense(params["HiddenLayers_0"][f"hidden_{i}"], x))
    mean, log_std = jax.jit(actor.apply)({"params": params}, observation)
    assert_allclose(mean, dense(params["mean"], x), rtol=1e-4, atol=1e-4)
    free = dense(params["log_std"], x)
    assert free.min() < -0.5
    assert free.max() > 0.25
    assert_allclose(log_std, np.clip(free, -0.5, 0.25), rtol=1e-4, atol=1e-4)
