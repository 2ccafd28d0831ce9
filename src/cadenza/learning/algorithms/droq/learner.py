"""DroQ: soft actor-critic with dropout and layer normalisation in the critics.

SAC is Haarnoja et al., Soft Actor-Critic Algorithms and Applications, 2018, whose symbols comments
use; its temperature is learnt as in the section "Automating Entropy Adjustment for Maximum Entropy
RL". DroQ is Hiraoka et al., Dropout Q-Functions for Doubly Efficient Reinforcement Learning, ICLR
2022. The hyperparameters are those of Zakka et al., RoboPianist, CoRL 2023.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.droq.networks import Actor, Critic
from cadenza.learning.algorithms.on_jax import JaxLearner, learning_rate_schedule, named_weights
from cadenza.learning.learner import Ends
from cadenza.learning.observation import Inputs
from cadenza.learning.policy import Perceptron
from cadenza.learning.replay_buffer import Batch

Params = Any  # nested dictionaries of arrays
Metrics = dict[str, Any]


class DroQState(NamedTuple):
    """Everything that learning changes."""

    key: jax.Array
    updates: jax.Array
    actor: Params
    actor_ema: Params  # exponential moving average of the actor, which is evaluated and saved
    critics: tuple[Params, ...]
    target_critics: tuple[Params, ...]
    log_alpha: jax.Array  # logarithm of the entropy temperature alpha
    actor_opt_state: Any
    critic_opt_state: Any
    alpha_opt_state: Any


def actor_weights(actor: Params) -> dict[str, NDArray[np.float32]]:
    """The weights of an actor by the names that `Perceptron` gives them."""
    heads = {name: actor[name] for name in ("mean", "log_std")}
    return named_weights(actor["HiddenLayers_0"] | heads)


def adam(
    config: DroQConfig, learning_rate: float, ends: Ends, every: int = 1
) -> optax.GradientTransformation:
    """Adam that steps once in `every` updates, so its schedule is as much shorter."""
    ends = tuple((-(-begin // every), -(-end // every)) for begin, end in ends)
    rate = learning_rate_schedule(learning_rate, config.final_learning_rate_fraction, ends)
    return optax.adam(rate, config.adam_beta1, config.adam_beta2)


class DroQ(JaxLearner[DroQState]):
    """A `Learner` that updates a `DroQState` by batches of transitions.

    Attributes:
        target_entropy: The target entropy of the policy [nat].
    """

    def __init__(
        self, config: DroQConfig, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)
    ) -> None:
        """Build the networks and their optimisers; nothing is drawn yet.

        The actor observes `inputs`, the critics A = `action_size` actions besides. Learning rates
        decay up to the `ends`, see `learning_rate_schedule`.
        """
        super().__init__()
        actions = tuple(range(inputs.total, inputs.total + action_size))
        self._config = config
        self._action_size, self._num_inputs = action_size, len(inputs.kept)
        self._actor: Any = Actor(config, inputs, action_size)
        self._critic: Any = Critic(
            config, Inputs(inputs.kept + actions, inputs.total + action_size)
        )
        default = -action_size / 2
        self.target_entropy = default if config.target_entropy is None else config.target_entropy
        # The actor and alpha are updated once in `policy_delay` updates of the critics.
        delay = config.policy_delay
        self._actor_optimizer = adam(config, config.actor_learning_rate, ends, delay)
        self._alpha_optimizer = adam(config, config.temperature_learning_rate, ends, delay)
        self._critic_optimizer = adam(config, config.critic_learning_rate, ends)

    def _draw_state(self, key: jax.Array) -> DroQState:
        """Draw the weights; the target critics and the average begin as copies."""
        config = self._config
        key, actor_key, *critic_keys = jax.random.split(key, 2 + config.num_critics)
        observation = jnp.zeros((1, self._num_inputs))
        action = jnp.zeros((1, self._action_size))
        actor = self._actor.init(actor_key, observation)["params"]
        critics = tuple(
            self._critic.init({"params": key, "dropout": key}, observation, action)["params"]
            for key in critic_keys
        )
        log_alpha = jnp.log(jnp.float32(config.initial_temperature))
        return DroQState(
            key=jax.random.key_data(key),
            updates=jnp.zeros((), jnp.int32),
            actor=actor,
            actor_ema=jax.tree.map(jnp.copy, actor),
            critics=critics,
            target_critics=jax.tree.map(jnp.copy, critics),
            log_alpha=log_alpha,
            actor_opt_state=self._actor_optimizer.init(actor),
            critic_opt_state=self._critic_optimizer.init(critics),
            alpha_opt_state=self._alpha_optimizer.init(log_alpha),
        )

    def policy(self, state: DroQState) -> Perceptron:
        """The policy of the averaged actor."""
        return self._policy(state.actor_ema)

    def behavior_policy(self, state: DroQState) -> Perceptron:
        """The policy of the latest actor."""
        return self._policy(state.actor)

    def _policy(self, actor: Params) -> Perceptron:
        config = self._config
        log_std_range = (config.log_std_min, config.log_std_max)
        return Perceptron(actor_weights(actor), config.activation, log_std_range)

    def _update(self, state: DroQState, batch: Batch) -> tuple[DroQState, Metrics]:
        """Update the critics, and once in `policy_delay` times the actor and the temperature."""
        key, critic_key, actor_key = jax.random.split(jax.random.wrap_key_data(state.key), 3)
        state, critic_metrics = self._update_critics(state, batch, critic_key)
        state, actor_metrics = jax.lax.cond(
            state.updates % self._config.policy_delay == 0,
            partial(self._update_actor_and_alpha, batch=batch, key=actor_key),
            lambda state: (state, {"actor_loss": jnp.nan, "entropy": jnp.nan}),
            state,
        )
        state = state._replace(key=jax.random.key_data(key), updates=state.updates + 1)
        metrics = critic_metrics | actor_metrics | {"temperature": jnp.exp(state.log_alpha)}
        return state, metrics

    def _update_critics(
        self, state: DroQState, batch: Batch, key: jax.Array
    ) -> tuple[DroQState, Metrics]:
        action_key, target_key, dropout_key = jax.random.split(key, 3)
        alpha, gamma = jnp.exp(state.log_alpha), self._config.discount
        # y = r + gamma (1 - d) (min_i Q'_i(s', a') - alpha log pi(a' | s')),  a' ~ pi(. | s')
        next_action, next_log_pi = self._sample(state.actor, batch.next_observation, action_key)
        next_q = self._q_values(
            state.target_critics, batch.next_observation, next_action, target_key
        )
        next_value = next_q.min(axis=0) - alpha * next_log_pi
        target = batch.reward + gamma * batch.discount * next_value

        # J_Q = E[(Q_i(s, a) - y)^2], the soft Bellman residual
        def critic_loss(critics: Params) -> tuple[jax.Array, jax.Array]:
            q = self._q_values(critics, batch.observation, batch.action, dropout_key)
            return ((q - target) ** 2).mean(), q.mean()

        (loss, value), gradient = jax.value_and_grad(critic_loss, has_aux=True)(state.critics)
        updates, opt_state = self._critic_optimizer.update(gradient, state.critic_opt_state)
        critics = optax.apply_updates(state.critics, updates)
        # Q' <- tau Q + (1 - tau) Q'
        target_critics = optax.incremental_update(critics, state.target_critics, self._config.tau)
        state = state._replace(
            critics=critics, target_critics=target_critics, critic_opt_state=opt_state
        )
        return state, {"critic_loss": loss, "value": value}

    def _update_actor_and_alpha(
        self, state: DroQState, batch: Batch, key: jax.Array
    ) -> tuple[DroQState, Metrics]:
        action_key, dropout_key = jax.random.split(key)
        alpha = jnp.exp(state.log_alpha)

        # J_pi = E[alpha log pi(a | s) - Q(s, a)],  a ~ pi(. | s); DroQ takes the critics' mean.
        def actor_loss(actor: Params) -> tuple[jax.Array, jax.Array]:
            action, log_pi = self._sample(actor, batch.observation, action_key)
            q = self._q_values(state.critics, batch.observation, action, dropout_key).mean(axis=0)
            return (alpha * log_pi - q).mean(), -log_pi.mean()

        # J_alpha = alpha (H(pi) - target entropy)
        def alpha_loss(log_alpha: jax.Array) -> jax.Array:
            return jnp.exp(log_alpha) * (entropy - self.target_entropy)

        (loss, entropy), gradient = jax.value_and_grad(actor_loss, has_aux=True)(state.actor)
        updates, actor_opt_state = self._actor_optimizer.update(gradient, state.actor_opt_state)
        actor = optax.apply_updates(state.actor, updates)
        alpha_update, alpha_opt_state = self._alpha_optimizer.update(
            jax.grad(alpha_loss)(state.log_alpha), state.alpha_opt_state
        )
        state = state._replace(
            actor=actor,
            actor_ema=optax.incremental_update(actor, state.actor_ema, self._config.actor_ema),
            log_alpha=optax.apply_updates(state.log_alpha, alpha_update),
            actor_opt_state=actor_opt_state,
            alpha_opt_state=alpha_opt_state,
        )
        return state, {"actor_loss": loss, "entropy": entropy}

    def _sample(
        self, actor: Params, observation: Any, key: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Draw actions (B, A) with log pi (B,), as in SAC's appendix on action bounds."""
        mean, log_std = self._actor.apply({"params": actor}, observation)
        noise = jax.random.normal(key, mean.shape)
        u = mean + jnp.exp(log_std) * noise
        log_normal = -0.5 * noise**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
        # log(1 - tanh(u)^2) = 2 (log 2 - u - softplus(-2 u)), without loss of digits
        log_squash = 2 * (jnp.log(2.0) - u - jax.nn.softplus(-2 * u))
        return jnp.tanh(u), (log_normal - log_squash).sum(axis=-1)

    def _q_values(
        self, critics: tuple[Params, ...], observation: Any, action: Any, key: jax.Array
    ) -> jax.Array:
        """Q-values (C, B) of each critic, with dropout, as everywhere in DroQ."""
        # One after the other: products of stacked matrices take a little longer on a CPU.
        keys = jax.random.split(key, len(critics))
        q_values = [
            self._critic.apply({"params": params}, observation, action, rngs={"dropout": dropout})
            for params, dropout in zip(critics, keys, strict=True)
        ]
        return jnp.stack(q_values)
