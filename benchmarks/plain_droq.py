"""DroQ written plainly, with the operations and sizes of the published learner, to compare with.

The published learner is the one that RoboPianist (Zakka et al., CoRL 2023) was trained with,
github.com/kevinzakka/robopianist-rl: flax's layers, critics stacked by `nn.vmap`, a call an update,
whole observations kept for every transition. Its run script asks for GELU, the paper for ReLU. What
`cadenza.learning` does differently can be chosen one by one.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax.scipy.stats import norm
from numpy.typing import NDArray

from cadenza.learning.replay_buffer import Batch

Params = Any  # nested dictionaries of arrays
Function = Callable[[jax.Array], jax.Array]
Figures = dict[str, jax.Array]

HIDDEN_LAYERS, WIDTH = 3, 256
NUM_CRITICS = 2
DROPOUT = 0.01
LOG_STD_RANGE = (-20.0, 2.0)
LEARNING_RATE = 3e-4
DISCOUNT = 0.99
TAU = 0.005

flax_dropout = partial(nn.Dropout, DROPOUT, deterministic=False)
_Dense = partial(nn.Dense, kernel_init=nn.initializers.xavier_uniform())


class Actor(nn.Module):
    """Observations (..., D) to mean and logarithm of the deviation of actions (..., A) each."""

    action_size: int
    activation: Function

    @nn.compact
    def __call__(self, x: jax.Array) -> tuple[jax.Array, jax.Array]:
        for i in range(HIDDEN_LAYERS):
            x = self.activation(_Dense(WIDTH, name=f"hidden_{i}")(x))
        mean = _Dense(self.action_size, name="mean")(x)
        log_std = _Dense(self.action_size, name="log_std")(x)
        return mean, jnp.clip(log_std, *LOG_STD_RANGE)


class Critic(nn.Module):
    """Observations (..., D) and actions (..., A) to values (...)."""

    activation: Function
    dropout: Callable[[], Function]

    @nn.compact
    def __call__(self, observation: jax.Array, action: jax.Array) -> jax.Array:
        x = jnp.concatenate([observation, action], axis=-1)
        for i in range(HIDDEN_LAYERS):
            x = _Dense(WIDTH, name=f"hidden_{i}")(x)
            x = self.dropout()(x)
            x = nn.LayerNorm(name=f"LayerNorm_{i}")(x)
            x = self.activation(x)
        return _Dense(1, name="value")(x)[..., 0]


class Critics(nn.Module):
    """Observations (B, D) and actions (B, A) to what each critic says (C, B)."""

    activation: Function
    dropout: Callable[[], Function]
    stacked: bool

    @nn.compact
    def __call__(self, observation: jax.Array, action: jax.Array) -> jax.Array:
        if self.stacked:
            all_at_once = nn.vmap(
                Critic,
                in_axes=None,
                axis_size=NUM_CRITICS,
                variable_axes={"params": 0},
                split_rngs={"params": True, "dropout": True},
            )
            return all_at_once(self.activation, self.dropout, name="all")(observation, action)
        each = [
            Critic(self.activation, self.dropout, name=f"critic_{i}") for i in range(NUM_CRITICS)
        ]
        return jnp.stack([critic(observation, action) for critic in each])


class PlainState(NamedTuple):
    """The state of training: parameters, optimisers and the random key."""

    key: jax.Array
    actor: Params
    critics: Params
    target_critics: Params
    log_alpha: jax.Array
    actor_opt_state: Any
    critic_opt_state: Any
    alpha_opt_state: Any


class PlainLearner:
    """Improves a `PlainState` by a batch of transitions at a time."""

    def __init__(
        self,
        observation_size: int,
        action_size: int,
        activation: Function = nn.relu,
        dropout: Callable[[], Function] = flax_dropout,
        stacked: bool = True,
    ) -> None:
        """Args:
        observation_size: D.
        action_size: A.
        activation: after every hidden layer.
        dropout: makes the module that drops what a hidden layer of a critic puts out.
        stacked: whether the critics' weights are stacked, or each is a network of its own.
        """
        self._sizes = observation_size, action_size
        self._actor = Actor(action_size, activation)
        self._critics = Critics(activation, dropout, stacked)
        self._adam = optax.adam(LEARNING_RATE)
        self._target_entropy = -action_size / 2
        self._update_once = jax.jit(self._update)
        self._act_once = jax.jit(self._act)

    def init(self, seed: int) -> PlainState:
        key, actor_key, critic_key = jax.random.split(jax.random.key(seed), 3)
        observation, action = (jnp.zeros((1, size)) for size in self._sizes)
        actor = self._actor.init(actor_key, observation)["params"]
        rngs = {"params": critic_key, "dropout": critic_key}
        critics = self._critics.init(rngs, observation, action)["params"]
        log_alpha = jnp.zeros(())
        return PlainState(
            key=key,
            actor=actor,
            critics=critics,
            target_critics=critics,
            log_alpha=log_alpha,
            actor_opt_state=self._adam.init(actor),
            critic_opt_state=self._adam.init(critics),
            alpha_opt_state=self._adam.init(log_alpha),
        )

    def act(
        self, state: PlainState, observation: NDArray[np.float32]
    ) -> tuple[PlainState, NDArray[np.float32]]:
        """An action (A,) in [-1, 1], drawn for one observation (D,)."""
        key, action = self._act_once(state.key, state.actor, observation)
        return state._replace(key=key), np.asarray(action)

    def update(self, state: PlainState, batch: Batch) -> tuple[PlainState, Figures]:
        """Updates by one batch (B, ...), and returns the new state and figures by name."""
        return self._update_once(state, batch)

    def _act(
        self, key: jax.Array, actor: Params, observation: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        key, draw = jax.random.split(key)
        return key, self._draw(actor, observation, draw)[0]

    def _update(self, state: PlainState, batch: Batch) -> tuple[PlainState, Figures]:
        key, critic_key, actor_key = jax.random.split(state.key, 3)
        state, critic_metrics = self._update_critics(state._replace(key=key), batch, critic_key)
        state, actor_metrics = self._update_actor(state, batch, actor_key)
        state, alpha_metrics = self._update_alpha(state, actor_metrics["entropy"])
        return state, critic_metrics | actor_metrics | alpha_metrics

    def _update_critics(
        self, state: PlainState, batch: Batch, key: jax.Array
    ) -> tuple[PlainState, Figures]:
        draw, drop_next, drop = jax.random.split(key, 3)
        action, log_prob = self._draw(state.actor, batch.next_observation, draw)
        next_q = self._values(state.target_critics, batch.next_observation, action, drop_next)
        next_value = next_q.min(axis=0) - jnp.exp(state.log_alpha) * log_prob
        target_q = batch.reward + DISCOUNT * batch.discount * next_value

        def loss(critics: Params) -> tuple[jax.Array, jax.Array]:
            q_values = self._values(critics, batch.observation, batch.action, drop)
            return jnp.mean((q_values - target_q) ** 2), q_values.mean()

        (critic_loss, value), gradient = jax.value_and_grad(loss, has_aux=True)(state.critics)
        critics, opt_state = self._apply_gradient(gradient, state.critic_opt_state, state.critics)
        state = state._replace(
            critics=critics,
            target_critics=optax.incremental_update(critics, state.target_critics, TAU),
            critic_opt_state=opt_state,
        )
        return state, {"critic_loss": critic_loss, "value": value}

    def _update_actor(
        self, state: PlainState, batch: Batch, key: jax.Array
    ) -> tuple[PlainState, Figures]:
        draw, drop = jax.random.split(key)

        def loss(actor: Params) -> tuple[jax.Array, jax.Array]:
            action, log_prob = self._draw(actor, batch.observation, draw)
            value = self._values(state.critics, batch.observation, action, drop).mean(axis=0)
            return jnp.mean(jnp.exp(state.log_alpha) * log_prob - value), -log_prob.mean()

        (actor_loss, entropy), gradient = jax.value_and_grad(loss, has_aux=True)(state.actor)
        actor, opt_state = self._apply_gradient(gradient, state.actor_opt_state, state.actor)
        state = state._replace(actor=actor, actor_opt_state=opt_state)
        return state, {"actor_loss": actor_loss, "entropy": entropy}

    def _update_alpha(self, state: PlainState, entropy: jax.Array) -> tuple[PlainState, Figures]:
        def loss(log_alpha: jax.Array) -> jax.Array:
            return jnp.exp(log_alpha) * (entropy - self._target_entropy)

        gradient = jax.grad(loss)(state.log_alpha)
        log_alpha, opt_state = self._apply_gradient(
            gradient, state.alpha_opt_state, state.log_alpha
        )
        state = state._replace(log_alpha=log_alpha, alpha_opt_state=opt_state)
        return state, {"temperature": jnp.exp(log_alpha)}

    def _apply_gradient(
        self, gradient: Params, opt_state: Any, params: Params
    ) -> tuple[Params, Any]:
        updates, opt_state = self._adam.update(gradient, opt_state)
        return optax.apply_updates(params, updates), opt_state

    def _draw(self, actor: Params, observation: Any, key: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Actions (..., A) and the logarithms (...) of their probability densities."""
        mean, log_std = self._apply(self._actor, actor, observation)
        std = jnp.exp(log_std)
        u = mean + std * jax.random.normal(key, mean.shape)
        # log(1 - tanh(u)^2), in a form that loses no digits
        log_slope = 2 * (jnp.log(2.0) - u - jax.nn.softplus(-2 * u))
        log_prob = norm.logpdf(u, mean, std) - log_slope
        return jnp.tanh(u), log_prob.sum(axis=-1)

    def _values(self, critics: Params, observation: Any, action: Any, drop: jax.Array) -> jax.Array:
        return self._apply(self._critics, critics, observation, action, rngs={"dropout": drop})

    def _apply(self, network: nn.Module, params: Params, *inputs: Any, **options: Any) -> Any:
        return network.apply({"params": params}, *inputs, **options)


class PlainBuffer:
    """A ring of transitions, each with both of its observations."""

    def __init__(self, observation_size: int, action_size: int, capacity: int) -> None:
        self._columns = Batch(
            observation=np.zeros((capacity, observation_size), np.float32),
            action=np.zeros((capacity, action_size), np.float32),
            reward=np.zeros(capacity, np.float32),
            discount=np.zeros(capacity, np.float32),
            next_observation=np.zeros((capacity, observation_size), np.float32),
        )
        self._capacity, self._next, self._size = capacity, 0, 0

    @property
    def nbytes(self) -> int:
        """Bytes of all transitions."""
        return sum(column.nbytes for column in self._columns)

    def insert(self, transition: Batch) -> None:
        """Adds a transition, (D,), (A,), (), (), (D,)."""
        for column, value in zip(self._columns, transition, strict=True):
            column[self._next] = value
        self._next = (self._next + 1) % self._capacity
        self._size = min(self._size + 1, self._capacity)

    def sample(self, rng: np.random.Generator, number: int) -> Batch:
        """Transitions (number, ...) drawn uniformly with replacement."""
        drawn = rng.integers(self._size, size=number)
        return Batch(*(column[drawn] for column in self._columns))
