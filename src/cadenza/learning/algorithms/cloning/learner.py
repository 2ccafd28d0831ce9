"""Behaviour cloning: regression of a demonstrator's actions on what was observed."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple, Protocol

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from cadenza.learning.algorithms.cloning.hyperparameters import Hyperparameters
from cadenza.learning.algorithms.on_jax import (
    ACTIVATIONS,
    falling,
    from_arrays,
    named_weights,
    start_jax,
    to_arrays,
    xavier,
)
from cadenza.learning.learner import Ends
from cadenza.learning.observation import Floats, Inputs
from cadenza.learning.policy import Perceptron

_NO_NOISE = -20.0  # the logarithm of the deviation of a clone's actions: they are certain


class Examples(Protocol):
    """What is learnt from; arrays (U, B, D) and (U, B, A). A `Batch` of transitions is one, too."""

    @property
    def observation(self) -> Floats: ...

    @property
    def action(self) -> Floats: ...


class CloningState(NamedTuple):
    """All that learning changes."""

    params: Any
    optimiser: Any


class Actor(nn.Module):
    """Observations (..., D) to actions (..., A) in [-1, 1]."""

    config: Hyperparameters
    action_size: int

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for i, size in enumerate(self.config.hidden_sizes):
            x = nn.Dense(size, kernel_init=xavier, name=f"hidden_{i}")(x)
            x = ACTIVATIONS[self.config.activation](x)
        return jnp.tanh(nn.Dense(self.action_size, kernel_init=xavier, name="mean")(x))


class Cloning:
    """Improves a `CloningState` by examples; a `Learner`.

    Attributes:
        num_threads: with how many JAX adds numbers up, if the system tells.
    """

    def __init__(
        self, config: Hyperparameters, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)
    ) -> None:
        """Args:
        config: what can be chosen.
        inputs: those of the actor.
        action_size: A.
        ends: of the learning rate, see `falling`.
        """
        self.num_threads = start_jax()
        self._config, self._num_inputs = config, len(inputs.kept)
        self._actor = Actor(config, action_size)
        rate = falling(config.learning_rate, config.final_learning_rate_fraction, ends)
        self._optimiser = optax.adam(rate)
        self._update_all = jax.jit(partial(jax.lax.scan, self._update), donate_argnums=0)

    def init(self, seed: int) -> CloningState:
        """Weights are drawn."""
        return self._draw_state(jax.random.key(seed))

    @partial(jax.jit, static_argnums=0)
    def _draw_state(self, key: jax.Array) -> CloningState:
        params = self._actor.init(key, jnp.zeros((1, self._num_inputs)))["params"]
        return CloningState(params, self._optimiser.init(params))

    def update(
        self, state: CloningState, batches: Examples
    ) -> tuple[CloningState, dict[str, NDArray[Any]]]:
        """One update for each of the batches (U, B, ...); `state` is used up.

        Returns:
            The new state, and by name metrics (U,) of each update.
        """
        return self._update_all(state, (batches.observation, batches.action))

    def error(self, state: CloningState, examples: Examples) -> float:
        """The mean squared error on examples (B, ...) that are not learnt from."""
        return float(self._error(state.params, (examples.observation, examples.action)))

    def policy(self, state: CloningState) -> Perceptron:
        """What was learnt; its samples are its modes."""
        weights = named_weights(state.params)
        weights["log_std/kernel"] = np.zeros_like(weights["mean/kernel"])
        weights["log_std/bias"] = np.full_like(weights["mean/bias"], _NO_NOISE)
        return Perceptron(weights, self._config.activation, (_NO_NOISE, _NO_NOISE))

    behavior_policy = policy

    def to_arrays(self, state: CloningState) -> dict[str, NDArray[Any]]:
        """To keep; see `from_arrays`."""
        return to_arrays(state)

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> CloningState:
        """The state that was kept.

        Raises:
            CadenzaError: it is not that of such a learner.
        """
        return from_arrays(arrays, jax.eval_shape(self._draw_state, jax.random.key(0)))

    @partial(jax.jit, static_argnums=0)
    def _error(self, params: Any, examples: tuple[jax.Array, jax.Array]) -> jax.Array:
        observation, action = examples
        done: Any = self._actor.apply({"params": params}, observation)
        return ((done - action) ** 2).mean()

    def _update(
        self, state: CloningState, examples: tuple[jax.Array, jax.Array]
    ) -> tuple[CloningState, dict[str, Any]]:
        error, gradient = jax.value_and_grad(self._error)(state.params, examples)
        change, optimiser = self._optimiser.update(gradient, state.optimiser)
        return CloningState(optax.apply_updates(state.params, change), optimiser), {"error": error}
