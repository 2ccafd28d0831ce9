"""DroQ: soft actor-critic with dropout and layer normalisation in the critics.

Haarnoja et al., Soft Actor-Critic Algorithms and Applications, 2018; Hiraoka et al., Dropout
Q-Functions for Doubly Efficient Reinforcement Learning, ICLR 2022; the figures are those of Zakka
et al., RoboPianist, CoRL 2023.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from cadenza.learning.algorithms.droq.hyperparameters import Hyperparameters
from cadenza.learning.algorithms.droq.networks import Actor, Critic
from cadenza.learning.algorithms.on_jax import (
    falling,
    from_arrays,
    named_weights,
    start_jax,
    to_arrays,
)
from cadenza.learning.learner import Ends
from cadenza.learning.observation import Inputs
from cadenza.learning.policy import Perceptron
from cadenza.learning.replay_buffer import Batch

Params = Any  # nested dictionaries of arrays


class DroQState(NamedTuple):
    """All that learning changes."""

    key: jax.Array
    updates: jax.Array
    actor: Params
    actor_ema: Params
    """What is evaluated and kept."""
    critics: tuple[Params, ...]
    targets: tuple[Params, ...]
    log_temperature: jax.Array
    actor_optimiser: Any
    critic_optimiser: Any
    temperature_optimiser: Any


def weights_of(actor: Params) -> dict[str, NDArray[np.float32]]:
    """The weights of an actor as `Perceptron` names them."""
    heads = {name: actor[name] for name in ("mean", "log_std")}
    return named_weights(actor["HiddenLayers_0"] | heads)


class DroQ:
    """Improves a `DroQState` by batches of transitions; a `Learner`.

    Attributes:
        num_threads: with how many JAX adds numbers up, if the system tells.
    """

    def __init__(
        self, config: Hyperparameters, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)
    ) -> None:
        """Args:
        config: what can be chosen.
        inputs: those of the actor; the critics get the actions besides.
        action_size: A.
        ends: of the learning rates, see `falling`.
        """
        self.num_threads = start_jax()
        actions = tuple(range(inputs.total, inputs.total + action_size))
        self._config = config
        self._action_size, self._ends = action_size, ends
        self._num_inputs = len(inputs.kept)
        self._actor = Actor(config, inputs, action_size)
        self._critic = Critic(config, Inputs(inputs.kept + actions, inputs.total + action_size))
        half = -action_size / 2
        self.target_entropy = half if config.target_entropy is None else config.target_entropy
        self._update_all = jax.jit(partial(jax.lax.scan, self._update), donate_argnums=0)

    def init(self, seed: int) -> DroQState:
        """Weights are drawn; targets and average begin equal to them."""
        return self._draw_state(jax.random.key(seed))

    @partial(jax.jit, static_argnums=0)  # one programme compiles sooner than many small ones
    def _draw_state(self, key: jax.Array) -> DroQState:
        config = self._config
        key, actor_key, *critic_keys = jax.random.split(key, 2 + config.num_critics)
        observation = jnp.zeros((1, self._num_inputs))
        action = jnp.zeros((1, self._action_size))
        actor = self._actor.init(actor_key, observation)["params"]
        critics = tuple(
            self._critic.init({"params": key, "dropout": key}, observation, action)["params"]
            for key in critic_keys
        )
        log_temperature = jnp.log(jnp.float32(config.initial_temperature))
        return DroQState(
            key=jax.random.key_data(key),
            updates=jnp.zeros((), jnp.int32),
            actor=actor,
            actor_ema=jax.tree.map(jnp.copy, actor),
            critics=critics,
            targets=jax.tree.map(jnp.copy, critics),
            log_temperature=log_temperature,
            actor_optimiser=self._adam_of_policy(config.actor_learning_rate).init(actor),
            critic_optimiser=self._adam(config.critic_learning_rate).init(critics),
            temperature_optimiser=self._adam_of_policy(config.temperature_learning_rate).init(
                log_temperature
            ),
        )

    def update(self, state: DroQState, batches: Batch) -> tuple[DroQState, dict[str, Any]]:
        """One update for each of the batches (U, B, ...); `state` is used up.

        Returns:
            The new state, and by name metrics (U,) of each update.
        """
        return self._update_all(state, batches)

    def policy(self, state: DroQState) -> Perceptron:
        """That of the averaged actor."""
        return self._policy(state.actor_ema)

    def behavior_policy(self, state: DroQState) -> Perceptron:
        """That of the latest actor."""
        return self._policy(state.actor)

    def _policy(self, actor: Params) -> Perceptron:
        config = self._config
        log_std_range = (config.log_std_min, config.log_std_max)
        return Perceptron(weights_of(actor), config.activation, log_std_range)

    def to_arrays(self, state: DroQState) -> dict[str, NDArray[Any]]:
        """To keep; see `from_arrays`."""
        return to_arrays(state)

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> DroQState:
        """The state that was kept.

        Raises:
            CadenzaError: it is not that of such a learner.
        """
        return from_arrays(arrays, jax.eval_shape(self._draw_state, jax.random.key(0)))

    def _adam(self, learning_rate: float, every: int = 1) -> optax.GradientTransformation:
        """One that takes a step in every so many updates."""
        config = self._config
        ends = tuple((-(-begin // every), -(-end // every)) for begin, end in self._ends)
        rate = falling(learning_rate, config.final_learning_rate_fraction, ends)
        return optax.adam(rate, config.adam_beta1, config.adam_beta2)

    def _adam_of_policy(self, learning_rate: float) -> optax.GradientTransformation:
        """Of actor and temperature, which wait for the critics."""
        return self._adam(learning_rate, self._config.policy_delay)

    def _update(self, state: DroQState, batch: Batch) -> tuple[DroQState, dict[str, Any]]:
        key, critic_key, actor_key = jax.random.split(jax.random.wrap_key_data(state.key), 3)
        state, about_critics = self._update_critics(state, batch, critic_key)
        state, about_actor = jax.lax.cond(
            state.updates % self._config.policy_delay == 0,
            partial(self._update_actor, batch=batch, key=actor_key),
            self._keep_actor,
            state,
        )
        state = state._replace(key=jax.random.key_data(key), updates=state.updates + 1)
        temperature = {"temperature": jnp.exp(state.log_temperature)}
        return state, about_critics | about_actor | temperature

    def _update_critics(
        self, state: DroQState, batch: Batch, key: jax.Array
    ) -> tuple[DroQState, dict[str, Any]]:
        config = self._config
        draw, drop_next, drop = jax.random.split(key, 3)
        next_action, log_prob = self._draw(state.actor, batch.next_observation, draw)
        following = self._values(state.targets, batch.next_observation, next_action, drop_next)
        soft = following.min(axis=0) - jnp.exp(state.log_temperature) * log_prob
        target = batch.reward + config.discount * batch.discount * soft

        def loss(critics: Params) -> tuple[jax.Array, jax.Array]:
            values = self._values(critics, batch.observation, batch.action, drop)
            return ((values - target) ** 2).mean(), values.mean()

        (error, value), gradient = jax.value_and_grad(loss, has_aux=True)(state.critics)
        change, optimiser = self._adam(config.critic_learning_rate).update(
            gradient, state.critic_optimiser
        )
        critics = optax.apply_updates(state.critics, change)
        targets = optax.incremental_update(critics, state.targets, config.tau)
        state = state._replace(critics=critics, targets=targets, critic_optimiser=optimiser)
        return state, {"critic_loss": error, "value": value}

    def _update_actor(
        self, state: DroQState, batch: Batch, key: jax.Array
    ) -> tuple[DroQState, dict[str, Any]]:
        config = self._config
        draw, drop = jax.random.split(key)
        temperature = jnp.exp(state.log_temperature)

        def loss(actor: Params) -> tuple[jax.Array, jax.Array]:
            action, log_prob = self._draw(actor, batch.observation, draw)
            value = self._values(state.critics, batch.observation, action, drop).mean(axis=0)
            return (temperature * log_prob - value).mean(), -log_prob.mean()

        (error, entropy), gradient = jax.value_and_grad(loss, has_aux=True)(state.actor)
        change, actor_optimiser = self._adam_of_policy(config.actor_learning_rate).update(
            gradient, state.actor_optimiser
        )
        # The gradient of temperature * (entropy - target) by the logarithm of the temperature.
        too_much = temperature * (entropy - self.target_entropy)
        optimiser = self._adam_of_policy(config.temperature_learning_rate)
        cooler, temperature_optimiser = optimiser.update(too_much, state.temperature_optimiser)
        actor = optax.apply_updates(state.actor, change)
        averaged = optax.incremental_update(actor, state.actor_ema, config.actor_ema)
        state = state._replace(
            actor=actor,
            actor_ema=averaged,
            log_temperature=optax.apply_updates(state.log_temperature, cooler),
            actor_optimiser=actor_optimiser,
            temperature_optimiser=temperature_optimiser,
        )
        return state, {"actor_loss": error, "entropy": entropy}

    def _keep_actor(self, state: DroQState) -> tuple[DroQState, dict[str, Any]]:
        return state, {"actor_loss": jnp.float32(jnp.nan), "entropy": jnp.float32(jnp.nan)}

    def _draw(self, actor: Params, observation: Any, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Actions (B, A) and the logarithms (B,) of their probability densities."""
        mean, log_std = self._forward(actor, observation)
        noise = jax.random.normal(key, mean.shape)
        before = mean + jnp.exp(log_std) * noise
        log_normal = -0.5 * noise**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
        # log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2 u)), without loss of digits
        log_squash = 2 * (jnp.log(2.0) - before - jax.nn.softplus(-2 * before))
        return jnp.tanh(before), (log_normal - log_squash).sum(axis=-1)

    def _value(self, critic: Params, observation: Any, action: Any, drop: jax.Array) -> Any:
        return self._critic.apply({"params": critic}, observation, action, rngs={"dropout": drop})

    def _forward(self, actor: Params, observation: Any) -> Any:
        return self._actor.apply({"params": actor}, observation)

    def _values(
        self, critics: tuple[Params, ...], observation: Any, action: Any, key: jax.Array
    ) -> jax.Array:
        """(C, B) what each critic says, with dropout as in all of learning."""
        # One after the other: products of stacked matrices take a little longer on a CPU.
        drops = jax.random.split(key, len(critics))
        return jnp.stack(
            [
                self._value(params, observation, action, drop)
                for params, drop in zip(critics, drops, strict=True)
            ]
        )
