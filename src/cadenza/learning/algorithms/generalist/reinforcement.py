"""Improves the generalist's networks by proximal policy optimisation over many songs.

PPO is Schulman et al., Proximal Policy Optimization Algorithms, 2017. The fingers of a hand have
rewards and advantages of their own: a network that serves a finger learns from what that finger
does, and the one of the wrist and the forearm from all fingers of the hand.

RUN/weights.npz     the average of the networks of all rounds
"""

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.learning.algorithms.generalist.config import GeneralistReinforcementConfig
from cadenza.learning.algorithms.generalist.excerpt_run import ExcerptRun
from cadenza.learning.algorithms.generalist.excerpts import ExcerptRollout
from cadenza.learning.algorithms.generalist.hand_networks import (
    Array,
    Layers,
    hand_outputs,
    initial_layers,
    with_layers,
)
from cadenza.learning.algorithms.on_jax import from_arrays, to_arrays
from cadenza.learning.algorithms.ppo.learner import clipped_objective, gae
from cadenza.resumable import Arrays
from cadenza.scene.scene import Scene, hand_alone
from cadenza.scene.servos import servos_of

_VALUE_HIDDEN = (128, 64)  # widths of the hidden layers of the value functions
_MAX_GRADIENT_NORM = 1.0


class GeneralistPPOState(NamedTuple):
    """Everything that learning changes."""

    policy: list[Layers]
    policy_ema: list[Layers]
    values: list[Layers]
    policy_opt_state: Any
    value_opt_state: Any


class HandPPO:
    """PPO with an advantage for each part of a hand: the hand itself, and its F fingers."""

    def __init__(
        self,
        config: GeneralistReinforcementConfig,
        weights: Weights,
        scene: Scene,
        rng: np.random.Generator,
    ) -> None:
        """Build the optimisers, to begin with `weights`; `rng` draws values and batches."""
        fingers = servos_of(hand_alone(scene, scene.sides[0]).scene).finger
        self._config, self._weights, self._rng = config, weights, rng
        self._fingers = [fingers[network.servos[:, 0]] for network in weights.networks]
        self._num_fingers = int(fingers.max()) + 1
        # (A, 1 + F) one-hot: the part of a hand that each servo belongs to.
        self._part_of_servo = np.eye(self._num_fingers + 1, dtype=np.float32)[fingers + 1]
        steps = config.rollout_steps * config.num_envs * len(scene.sides)
        rounds = max(config.num_rounds - config.value_warmup, 1)
        num_updates = rounds * config.num_epochs * steps // config.batch_size
        rate = optax.linear_schedule(config.learning_rate, 0.0, max(num_updates, 1))
        self._policy_optimizer = optax.chain(
            optax.clip_by_global_norm(_MAX_GRADIENT_NORM), optax.adam(rate)
        )
        self._value_optimizer = optax.adam(config.value_learning_rate)
        self.corrections = jax.jit(self._corrections)
        self._jitted_values = jax.jit(self._values)
        self._jitted_log_prob = jax.jit(self._log_prob)
        self._policy_step = jax.jit(self._step(self._policy_optimizer, self._policy_loss))
        self._value_step = jax.jit(self._step(self._value_optimizer, self._value_loss))

    def init(self) -> GeneralistPPOState:
        """The state with the layers of the weights; the value functions are drawn."""
        networks = self._weights.networks
        policy = [list(zip(each.kernels, each.biases, strict=True)) for each in networks]
        values = [
            initial_layers((len(each.mean), *_VALUE_HIDDEN, 1), self._rng) for each in networks[1:]
        ]
        opt_states = self._policy_optimizer.init(policy), self._value_optimizer.init(values)
        return GeneralistPPOState(policy, policy, values, *opt_states)

    def weights(self, state: GeneralistPPOState) -> Weights:
        """The averaged networks; touches that were learnt for others are left out."""
        networks = map(with_layers, self._weights.networks, state.policy_ema)
        return self._weights._replace(networks=tuple(networks), striking=())

    def update(
        self, state: GeneralistPPOState, rollout: ExcerptRollout, values_only: bool
    ) -> GeneralistPPOState:
        """Update value functions, and unless `values_only` networks, by a rollout."""
        config = self._config
        inputs = rollout.inputs.reshape(-1, rollout.inputs.shape[-1])
        values = np.asarray(self._jitted_values(state.values, inputs))
        values = values.reshape(-1, *rollout.rewards[0].shape)
        finger_advantages = np.asarray(
            gae(rollout.rewards, values, rollout.ends, config.discount, config.gae_lambda)
        )
        returns = (finger_advantages + values[:-1]).reshape(-1, self._num_fingers)
        advantages = _normalised(finger_advantages).reshape(len(returns), -1)
        inputs = inputs[: len(returns)]
        corrections = rollout.corrections.reshape(len(returns), -1)
        log_prob = np.asarray(self._jitted_log_prob(state.policy, inputs, corrections))
        policy, value_layers = state.policy, state.values
        policy_opt, value_opt = state.policy_opt_state, state.value_opt_state
        size = min(config.batch_size, len(inputs))
        for _ in range(config.num_epochs):
            for rows in np.split(
                self._rng.permutation(len(inputs)), range(size, len(inputs), size)
            ):
                if not values_only:
                    batch = inputs[rows], corrections[rows], log_prob[rows], advantages[rows]
                    policy, policy_opt = self._policy_step(policy, policy_opt, *batch)
                value_layers, value_opt = self._value_step(
                    value_layers, value_opt, inputs[rows], returns[rows]
                )
        ema = jax.tree.map(
            lambda mean, now: mean + config.ema * (now - mean), state.policy_ema, policy
        )
        return GeneralistPPOState(policy, ema, value_layers, policy_opt, value_opt)

    @staticmethod
    def _step(optimizer: optax.GradientTransformation, loss: Any) -> Any:
        def step(layers: Any, opt_state: Any, *batch: Any) -> Any:
            updates, opt_state = optimizer.update(jax.grad(loss)(layers, *batch), opt_state, layers)
            return optax.apply_updates(layers, updates), opt_state

        return step

    def _corrections(self, policy: list[Layers], inputs: Any) -> Any:
        """Corrections (N, A) for inputs (N, D)."""
        corrections = jnp.zeros((len(inputs), len(self._part_of_servo)))
        for layers, network in zip(policy, self._weights.networks, strict=True):
            outputs = hand_outputs(layers, network, inputs)
            corrections = corrections.at[:, network.servos].set(outputs)
        return corrections

    def _values(self, layers: list[Layers], inputs: Any) -> Any:
        """Values (N, F) of the fingers for inputs (N, D)."""
        values = jnp.zeros((len(inputs), self._num_fingers))
        networks = zip(layers, self._weights.networks[1:], self._fingers[1:], strict=True)
        for own, network, fingers in networks:
            values = values.at[:, fingers].set(hand_outputs(own, network, inputs)[..., 0])
        return values

    def _log_prob(self, policy: list[Layers], inputs: Any, corrections: Any) -> Any:
        """Log probabilities (N, 1 + F) of each part's corrections, up to a constant."""
        z = (corrections - self._corrections(policy, inputs)) / self._config.noise
        return -0.5 * jnp.square(z) @ self._part_of_servo

    def _policy_loss(
        self,
        policy: list[Layers],
        inputs: Any,
        corrections: Any,
        old_log_prob: Any,
        advantages: Any,
    ) -> Any:
        """The negative clipped surrogate objective, summed over the parts of a hand."""
        log_ratio = self._log_prob(policy, inputs, corrections) - old_log_prob
        objective = clipped_objective(log_ratio, advantages, self._config.clip)
        return -objective.sum(axis=1).mean()

    def _value_loss(self, layers: list[Layers], inputs: Any, returns: Any) -> Any:
        return jnp.square(self._values(layers, inputs) - returns).mean()


def _normalised(advantages: Array) -> Array:
    """Normalised advantages (T, N, 1 + F) of the whole hand and each of its fingers.

    That of the hand is the sum of those (T, N, F) of its fingers.
    """
    centred = advantages - advantages.mean(axis=(0, 1))
    parts = np.concatenate([centred.sum(axis=-1, keepdims=True), centred], axis=-1)
    return parts / (parts.std(axis=(0, 1)) + np.finfo(np.float32).eps)


class GeneralistReinforcement(ExcerptRun):
    """A run of reinforcement learning; an update is a round of playing and learning."""

    command: ClassVar[str] = "cadenza generalist reinforce"
    config: GeneralistReinforcementConfig

    def _prepare(self, initial: Weights, scene: Scene) -> None:
        self._ppo = HandPPO(self.config, initial, scene, self._rng)
        self._state = self._ppo.init()

    def _learn(self) -> dict[str, Any]:
        config = self.config
        rollout = self._envs.rollout(self._policy, config.rollout_steps, config.noise)
        values_only = self.step < config.value_warmup
        self._state = self._ppo.update(self._state, rollout, values_only)
        self.step += 1
        return {"train/cost": float(-rollout.rewards.sum(axis=2).mean())}

    def _policy(self, inputs: Array) -> Array:
        return np.asarray(self._ppo.corrections(self._state.policy, inputs))

    def _arrays(self) -> Arrays:
        return to_arrays(self._state)

    def _restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        self._state = from_arrays(arrays, self._state)

    def _save_result(self) -> None:
        self._ppo.weights(self._state).save(self.folder.path / "weights.npz")
