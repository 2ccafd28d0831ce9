"""The actor and the critics: perceptrons."""

from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from cadenza.learning.algorithms.droq.config import DroQConfig
from cadenza.learning.algorithms.on_jax import ACTIVATIONS, xavier
from cadenza.learning.observation import Inputs


class Dropout(nn.Module):
    """Set a share `rate` of its inputs to zero and scale the others up.

    It is `flax.linen.Dropout` with other random bits: MurmurHash3's finaliser (A. Appleby) of the
    entry's index, with a new key each time. Better bits took a sixth of an update.
    """

    rate: float

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        key = jax.random.bits(self.make_rng("dropout"), (2,), jnp.uint32)
        bits = jax.lax.iota(jnp.uint32, x.size).reshape(x.shape) * jnp.uint32(0x9E3779B9) + key[0]
        bits = (bits ^ (bits >> 16)) * jnp.uint32(0x85EBCA6B) ^ key[1]
        bits = (bits ^ (bits >> 13)) * jnp.uint32(0xC2B2AE35)
        bits = bits ^ (bits >> 16)
        return jnp.where(bits >= jnp.uint32(self.rate * 2**32), x / (1 - self.rate), 0.0)


class FirstLayer(nn.Module):
    """A linear layer, initialised as its rows of the layer with all inputs."""

    size: int
    inputs: Inputs

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        def rows(key: Any, shape: tuple[int, int]) -> jax.Array:
            return xavier(key, (self.inputs.total, shape[1]))[np.array(self.inputs.kept)]

        kernel = self.param("kernel", rows, (len(self.inputs.kept), self.size))
        return x @ kernel + self.param("bias", nn.initializers.zeros, (self.size,))


class HiddenLayers(nn.Module):
    """Linear layers, each with optional dropout and layer normalisation, and activation."""

    config: DroQConfig
    inputs: Inputs
    dropout: float = 0.0
    layer_norm: bool = False

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for i, size in enumerate(self.config.hidden_sizes):
            name = f"hidden_{i}"
            if i:
                x = nn.Dense(size, kernel_init=xavier, name=name)(x)
            else:
                x = FirstLayer(size, self.inputs, name=name)(x)
            if self.dropout:
                x = Dropout(self.dropout)(x)
            if self.layer_norm:
                x = nn.LayerNorm()(x)
            x = ACTIVATIONS[self.config.activation](x)
        return x


class Actor(nn.Module):
    """Observations (..., D) to mean and logarithm of the deviation of actions (..., A) each.

    An action is the hyperbolic tangent of a sample of that normal distribution.
    """

    config: DroQConfig
    inputs: Inputs
    action_size: int

    @nn.compact
    def __call__(self, observation: jax.Array) -> tuple[jax.Array, jax.Array]:
        hidden = HiddenLayers(self.config, self.inputs)(observation)

        def scaled(key: Any, *of: Any) -> jax.Array:
            return self.config.initial_mean * xavier(key, *of)

        mean = nn.Dense(self.action_size, kernel_init=scaled, name="mean")(hidden)
        log_std = nn.Dense(self.action_size, kernel_init=xavier, name="log_std")(hidden)
        return mean, jnp.clip(log_std, self.config.log_std_min, self.config.log_std_max)


class Critic(nn.Module):
    """Observations (..., D) and actions (..., A) to values (...)."""

    config: DroQConfig
    inputs: Inputs  # entries of observation and action, concatenated

    @nn.compact
    def __call__(self, observation: jax.Array, action: jax.Array) -> jax.Array:
        both = jnp.concatenate([observation, action], axis=-1)
        config = self.config
        hidden = HiddenLayers(config, self.inputs, config.dropout, config.layer_norm)(both)
        return nn.Dense(1, kernel_init=xavier, name="value")(hidden)[..., 0]
