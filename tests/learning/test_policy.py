"""The policy that plays, in numpy, against the actor that learns, in flax."""

from typing import Any

import jax
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rl_examples import random_params
from scipy.stats import kstest

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.learner import actor_weights
from cadenza.learning.algorithms.droq.networks import Actor
from cadenza.learning.observation import Inputs
from cadenza.learning.policy import Perceptron

INPUTS, ACTIONS = 30, 3


class Both:
    """An actor with random weights, biases too, and the policy of the same weights."""

    def __init__(self, activation: Any, **options: Any) -> None:
        self.rng = np.random.default_rng(0)
        config = DroQConfig(hidden_sizes=(32, 16, 24), activation=activation, **options)
        actor = Actor(config, Inputs(tuple(range(INPUTS)), INPUTS), ACTIONS)
        params = random_params(actor, self.rng, np.zeros((1, INPUTS)), size=0.15)
        apply = jax.jit(actor.apply)
        self.actor = lambda x: tuple(map(np.asarray, apply({"params": params}, x)))
        limits = (config.log_std_min, config.log_std_max)
        self.policy = Perceptron(actor_weights(params), activation, limits)

    def observations(self, number: int) -> np.ndarray:
        return self.rng.standard_normal((number, INPUTS)).astype(np.float32)


@pytest.mark.parametrize("activation", ["relu", "gelu"])
def test_the_mode_is_the_squashed_mean_of_the_actor(activation):
    both = Both(activation)
    observation = both.observations(100)
    best = both.policy.mode(observation)
    assert best.dtype == np.float32
    assert_allclose(best, np.tanh(both.actor(observation)[0]), atol=1e-5)
    assert np.ptp(best) > 0.3


@pytest.mark.parametrize(
    ("activation", "limits"),
    [("relu", {}), ("gelu", {}), ("relu", {"log_std_min": -0.7, "log_std_max": -0.6})],
)
def test_draws_come_from_the_distribution_of_the_actor(activation, limits):
    """Draws before tanh are normal, with the actor's mean and deviation for each observation."""
    both = Both(activation, **limits)
    observation = np.repeat(both.observations(4), 3000, axis=0)
    drawn = both.policy.sample(observation, np.random.default_rng(1))
    assert drawn.dtype == np.float32
    assert np.abs(drawn).max() <= 1
    mean, log_std = both.actor(observation)
    normal = (np.arctanh(drawn.astype(np.float64)) - mean) / np.exp(log_std)
    for action in range(ACTIONS):
        for part in normal[:, action].reshape(4, -1):
            assert kstest(part, "norm").pvalue > 1e-4
    assert np.abs(np.corrcoef(normal.T) - np.eye(ACTIONS)).max() < 5 / np.sqrt(len(normal))


def test_draws_follow_their_generator():
    both = Both("relu")
    observation = both.observations(5)
    draws = [both.policy.sample(observation, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert_array_equal(draws[0], draws[1])
    assert (draws[0] != draws[2]).all()
