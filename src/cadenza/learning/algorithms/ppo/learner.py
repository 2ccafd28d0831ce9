"""Proximal policy optimisation, as in `ppo_continuous_action.py` of CleanRL, in JAX.

PPO is Schulman et al., Proximal Policy Optimization Algorithms, 2017; CleanRL is Huang et al.,
CleanRL: High-quality Single-file Implementations of Deep Reinforcement Learning Algorithms, JMLR
2022. Four things differ:

- An action is the hyperbolic tangent of a normal sample, so that a `Perceptron` can play it. The
  ratio of probabilities is that of the sample.
- The end of a song truncates an episode, and the value of its last observation is counted.
- Observations are normalised by the statistics up to the previous rollout, so that updates are
  compared with the very policy that drew the rollout.
- The learning rate follows the divergence of the new policy from the old one, as in RSL-RL (Rudin
  et al., Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement Learning, 2021).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax

from cadenza.learning.algorithms.on_jax import ACTIVATIONS, StateOnJax, named_weights
from cadenza.learning.algorithms.ppo.config import PPOConfig
from cadenza.learning.env_rollout import Decision, EnvRollout
from cadenza.learning.learner import Ends
from cadenza.learning.observation import Inputs
from cadenza.learning.policy import Perceptron

Array = Any  # of JAX
Params = Any  # nested dictionaries of arrays

_MIN_STD = 0.1
"""Least standard deviation to which an observation is normalised: a goal that is hardly ever
there is not blown up when it is."""
_SMALL_GAIN = 0.01  # the first mean actions are nearly 0 (Andrychowicz et al., 2021)
_LOG_STD_RANGE = (-5.0, 2.0)
_ADAM_EPS = 1e-5
# The learning rate is changed by this factor where the divergence is off its target by more than
# twice, within these limits.
_RATE_FACTOR, _RATE_TOLERANCE, _RATE_RANGE = 1.5, 2.0, (1e-5, 1e-2)
_ADVANTAGE_EPS = 1e-8


class Normalisation(NamedTuple):
    """Running mean and variance of observations."""

    count: Array
    mean: Array
    variance: Array

    def updated(self, observation: Array) -> Normalisation:
        """Include observations (..., D), by Chan et al., Updating Formulae, 1979."""
        flat = observation.reshape(-1, observation.shape[-1])
        count, total = len(flat), self.count + len(flat)
        mean, variance = flat.mean(axis=0), flat.var(axis=0)
        between = (mean - self.mean) ** 2 * self.count * count / total
        squares = self.variance * self.count + variance * count + between
        return Normalisation(total, self.mean + (mean - self.mean) * count / total, squares / total)

    @property
    def std(self) -> Array:
        """Standard deviations (D,), `_MIN_STD` or more."""
        return jnp.maximum(jnp.sqrt(self.variance), _MIN_STD)


class PPOState(NamedTuple):
    """Everything that learning changes."""

    params: Params
    opt_state: Any
    learning_rate: Array
    normalisation: Normalisation


class PPOBatch(NamedTuple):
    """Transitions (B, ...) of a rollout with what is learnt from them."""

    observation: Array
    action: Array
    log_prob: Array
    advantage: Array
    returns: Array


class ActorCritic(nn.Module):
    """Observations (..., D) to means (..., A) and deviations (A,) of actions, and values (...)."""

    config: PPOConfig
    action_size: int

    @nn.compact
    def __call__(self, observation: Array) -> tuple[Array, Array, Array]:
        log_std = self.param(
            "log_std", nn.initializers.constant(np.log(self.config.initial_std)), self.action_size
        )
        mean = self._layers(observation, "actor", self.action_size, _SMALL_GAIN)
        value = self._layers(observation, "critic", 1, 1.0)
        return mean, jnp.exp(jnp.clip(log_std, *_LOG_STD_RANGE)), value[..., 0]

    def _layers(self, x: Array, name: str, outputs: int, gain: float) -> Array:
        for i, size in enumerate(self.config.hidden_sizes):
            x = nn.Dense(size, kernel_init=_orthogonal(np.sqrt(2)), name=f"{name}_hidden_{i}")(x)
            x = ACTIVATIONS[self.config.activation](x)
        return nn.Dense(outputs, kernel_init=_orthogonal(gain), name=f"{name}_out")(x)


class PPO(StateOnJax[PPOState]):
    """An `OnPolicyLearner` that updates a `PPOState` by rollouts."""

    def __init__(
        self, config: PPOConfig, inputs: Inputs, action_size: int, ends: Ends = ((0, 1),)
    ) -> None:
        """Build the network and its optimiser; nothing is drawn yet, nor depends on the `ends`."""
        super().__init__()
        self._config, self._num_inputs = config, len(inputs.kept)
        self._network = ActorCritic(config, action_size)
        self._optimizer = optax.chain(
            optax.clip_by_global_norm(config.max_gradient_norm), optax.scale_by_adam(eps=_ADAM_EPS)
        )
        self.act, self.value = jax.jit(self._act), jax.jit(self._value)
        self._learn_all = jax.jit(self._learn, donate_argnums=0)

    def _draw_state(self, key: Array) -> PPOState:
        params = self._network.init(key, jnp.zeros((1, self._num_inputs)))["params"]
        zeros = jnp.zeros(self._num_inputs)
        normalisation = Normalisation(jnp.zeros(()), zeros, zeros + 1)
        rate = jnp.float32(self._config.learning_rate)
        return PPOState(params, self._optimizer.init(params), rate, normalisation)

    def policy(self, state: PPOState) -> Perceptron:
        """The policy; its first layer normalises."""
        layers = {
            name.removeprefix("actor_").replace("out", "mean"): layer
            for name, layer in state.params.items()
            if name.startswith("actor_")
        }
        first, (_, mean, _) = layers["hidden_0"], state.normalisation
        kernel = first["kernel"] / state.normalisation.std[:, None]
        layers["hidden_0"] = {"kernel": kernel, "bias": first["bias"] - mean @ kernel}
        log_std = {
            "kernel": jnp.zeros_like(layers["mean"]["kernel"]),
            "bias": state.params["log_std"],
        }
        weights = named_weights(layers | {"log_std": log_std})
        return Perceptron(weights, self._config.activation, _LOG_STD_RANGE)

    behavior_policy = policy

    def update(
        self, state: PPOState, rollout: EnvRollout, rows: Array
    ) -> tuple[PPOState, dict[str, Array]]:
        """Make an update for each of the `rows` (U, B) of a rollout; see `OnPolicyLearner`."""
        return self._learn_all(state, rollout, rows)

    def _outputs(self, params: Params, normalisation: Normalisation, observation: Array) -> Any:
        normal = (observation - normalisation.mean) / normalisation.std
        return self._network.apply({"params": params}, normal)

    def _act(self, state: PPOState, observation: Array, key: Array) -> Decision:
        mean, std, value = self._outputs(state.params, state.normalisation, observation)
        action = mean + std * jax.random.normal(key, mean.shape)
        return Decision(action, _log_prob(action, mean, std), value)

    def _value(self, state: PPOState, observation: Array) -> Array:
        return self._outputs(state.params, state.normalisation, observation)[2]

    def _learn(
        self, state: PPOState, rollout: EnvRollout, rows: Array
    ) -> tuple[PPOState, dict[str, Array]]:
        config = self._config
        rewards = rollout.reward + config.discount * rollout.value_at_end
        values = jnp.concatenate([rollout.value, rollout.last_value[None]])
        advantages = gae(rewards, values, rollout.ended, config.discount, config.gae_lambda)
        parts = rollout.observation, rollout.action, rollout.log_prob
        steps = PPOBatch(*parts, advantages, advantages + rollout.value)
        flat = jax.tree.map(lambda part: part.reshape(-1, *part.shape[2:]), steps)

        def update(state: PPOState, rows: Array) -> tuple[PPOState, dict[str, Array]]:
            return self._update(state, jax.tree.map(lambda part: part[rows], flat))

        state, metrics = jax.lax.scan(update, state, rows)
        seen = state.normalisation.updated(rollout.observation)
        return state._replace(normalisation=seen), metrics

    def _update(self, state: PPOState, batch: PPOBatch) -> tuple[PPOState, dict[str, Array]]:
        gradient, metrics = jax.grad(self._loss, has_aux=True)(
            state.params, state.normalisation, batch
        )
        off = metrics["kl"] / self._config.target_kl
        factor = jnp.where(off > _RATE_TOLERANCE, 1 / _RATE_FACTOR, 1.0)
        factor = jnp.where(off < 1 / _RATE_TOLERANCE, _RATE_FACTOR, factor)
        rate = jnp.clip(state.learning_rate * factor, *_RATE_RANGE)
        directions, opt_state = self._optimizer.update(gradient, state.opt_state, state.params)
        params = jax.tree.map(lambda p, d: p - rate * d, state.params, directions)
        metrics |= {"learning_rate": rate}
        return PPOState(params, opt_state, rate, state.normalisation), metrics

    def _loss(
        self, params: Params, normalisation: Normalisation, batch: PPOBatch
    ) -> tuple[Array, dict[str, Array]]:
        config = self._config
        mean, std, value = self._outputs(params, normalisation, batch.observation)
        log_ratio = _log_prob(batch.action, mean, std) - batch.log_prob
        centred = batch.advantage - batch.advantage.mean()
        advantage = centred / (batch.advantage.std() + _ADVANTAGE_EPS)
        policy_loss = -clipped_objective(log_ratio, advantage, config.clip).mean()
        value_loss = ((value - batch.returns) ** 2).mean() / 2
        entropy = (jnp.log(std) + 0.5 * jnp.log(2 * jnp.pi * jnp.e)).sum()
        loss = policy_loss + config.value_coefficient * value_loss
        ratio = jnp.exp(log_ratio)
        metrics = {
            "policy_loss": policy_loss,
            "value_loss": value_loss,
            "entropy": entropy,
            "kl": (ratio - 1 - log_ratio).mean(),  # Schulman, Approximating KL Divergence, 2020
            "clipped": (jnp.abs(ratio - 1) > config.clip).mean(),
            "value": value.mean(),
        }
        return loss - config.entropy_coefficient * entropy, metrics


def gae(rewards: Array, values: Array, ended: Array, discount: float, gae_lambda: float) -> Array:
    """Generalised advantage estimates (T, N, ...).

    Schulman et al., High-Dimensional Continuous Control Using Generalized Advantage Estimation,
    2016.

    Args:
        rewards: (T, N, ...)
        values: (T + 1, N, ...)
        ended: (T, N) whether the episode ended with the step, over which no value is carried.
        discount: gamma.
        gae_lambda: lambda.
    """
    going_on = 1.0 - ended.reshape(ended.shape + (1,) * (rewards.ndim - ended.ndim))
    td_errors = rewards + discount * going_on * values[1:] - values[:-1]

    def step(advantage: Array, now: Any) -> tuple[Array, Array]:
        td_error, goes_on = now
        advantage = td_error + discount * gae_lambda * goes_on * advantage
        return advantage, advantage

    _, advantages = jax.lax.scan(
        step, jnp.zeros_like(td_errors[0]), (td_errors, going_on), reverse=True
    )
    return advantages


def clipped_objective(log_ratio: Array, advantage: Array, clip: float) -> Array:
    """PPO's clipped surrogate objective of each transition, to be maximised.

    `log_ratio` is of the new to the old probability, which may move from 1 by `clip`.
    """
    ratio = jnp.exp(log_ratio)
    return jnp.minimum(ratio * advantage, jnp.clip(ratio, 1 - clip, 1 + clip) * advantage)


def _log_prob(action: Array, mean: Array, std: Array) -> Array:
    """The log probability (...) of samples (..., A) before tanh."""
    z = (action - mean) / std
    return (-0.5 * z**2 - jnp.log(std) - 0.5 * jnp.log(2 * jnp.pi)).sum(axis=-1)


def _orthogonal(gain: float) -> Any:
    return nn.initializers.orthogonal(gain)
