"""Behaviour cloning: regression of a demonstrator's actions on observations."""

from functools import partial
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

from cadenza.learning.algorithms.cloning.config import CloningConfig
from cadenza.learning.algorithms.on_jax import (
    ACTIVATIONS,
    JaxLearner,
    learning_rate_schedule,
    named_weights,
    xavier,
)
from cadenza.learning.learner import Ends
from cadenza.learning.observation import Inputs
from cadenza.learning.policy import Perceptron

_LOG_STD = -20.0  # practically 0: a clone's actions are deterministic


Examples = tuple[Any, Any]  # observations (..., D), and the demonstrator's actions (..., A)


class CloningState(NamedTuple):
    """Everything that learning changes."""

    params: Any
    opt_state: Any


class CloningActor(nn.Module):
    """Observations (..., D) to actions (..., A) in [-1, 1]."""

    config: CloningConfig
    action_size: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for i, size in enumerate(self.config.hidden_sizes):
            x = nn.Dense(size, kernel_init=xavier, name=f"hidden_{i}")(x)
            x = ACTIVATIONS[self.config.activation](x)
        return jnp.tanh(nn.Dense(self.action_size, kernel_init=xavier, name="mean")(x))


class Cloning(JaxLearner[CloningState]):
    """A `Learner` that updates a `CloningState` by examples."""

    def __init__(
        self, config: CloningConfig, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)
    ) -> None:
        """Build the actor and its optimiser; for `ends` see `learning_rate_schedule`."""
        super().__init__()
        self._config, self._num_inputs = config, len(inputs.kept)
        self._actor = CloningActor(config, action_size)
        final = config.final_learning_rate_fraction
        self._optimizer = optax.adam(learning_rate_schedule(config.learning_rate, final, ends))

    def _draw_state(self, key: jax.Array) -> CloningState:
        params = self._actor.init(key, jnp.zeros((1, self._num_inputs)))["params"]
        return CloningState(params, self._optimizer.init(params))

    def error(self, state: CloningState, examples: Examples) -> float:
        """The mean squared error on examples (B, ...)."""
        return float(self._loss(state.params, examples))

    def policy(self, state: CloningState) -> Perceptron:
        """The policy, whose samples are its modes."""
        weights = named_weights(state.params)
        weights["log_std/kernel"] = np.zeros_like(weights["mean/kernel"])
        weights["log_std/bias"] = np.full_like(weights["mean/bias"], _LOG_STD)
        return Perceptron(weights, self._config.activation, (_LOG_STD, _LOG_STD))

    behavior_policy = policy

    @partial(jax.jit, static_argnums=0)
    def _loss(self, params: Any, examples: Examples) -> jax.Array:
        observation, action = examples
        predicted: Any = self._actor.apply({"params": params}, observation)
        return ((predicted - action) ** 2).mean()

    def _update(
        self, state: CloningState, examples: Examples
    ) -> tuple[CloningState, dict[str, Any]]:
        loss, gradient = jax.value_and_grad(self._loss)(state.params, examples)
        updates, opt_state = self._optimizer.update(gradient, state.opt_state)
        return CloningState(optax.apply_updates(state.params, updates), opt_state), {"error": loss}
