"""The actor and the critics: perceptrons."""

from __future__ import annotations

from functools import partial
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np

from cadenza.agents.rl.config import LearnerConfig
from cadenza.agents.rl.observation import Inputs

_ACTIVATIONS = {"relu": nn.relu, "gelu": nn.gelu}
_xavier = nn.initializers.xavier_uniform()


class Dropout(nn.Module):
    """Sets a share `rate` of its inputs to zero and scales the others up.

    As `flax.linen.Dropout`, but random by the finaliser of MurmurHash3 (A. Appleby) on the number
    of the entry, keyed anew each time: generating better bits took a sixth of an update.
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


@partial(jax.custom_vjp, nondiff_argnums=(1,))
def to_all(row: jax.Array, shape: tuple[int, ...]) -> jax.Array:
    """A row (H,) for every sample, (..., H): broadcasting, with a gradient of the same bits always.

    How XLA sums over samples, and with it the last digits of all that is learnt, depends on the
    number of its threads; a product with ones does not.
    """
    return jnp.broadcast_to(row, shape)


def _to_all_forward(row: jax.Array, shape: tuple[int, ...]) -> tuple[jax.Array, None]:
    return to_all(row, shape), None


def _to_all_backward(shape: tuple[int, ...], _: None, gradient: jax.Array) -> tuple[jax.Array]:
    samples = gradient.reshape(-1, shape[-1])
    return (jnp.ones(len(samples)) @ samples,)


to_all.defvjp(_to_all_forward, _to_all_backward)


class Linear(nn.Module):
    """A linear layer.

    With `inputs` its weights begin as those rows that it has of the layer with all inputs.
    """

    size: int
    inputs: Inputs | None = None

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        kernel = self.param("kernel", self._draw, (x.shape[-1], self.size))
        bias = self.param("bias", nn.initializers.zeros, (self.size,))
        return x @ kernel + to_all(bias, (*x.shape[:-1], self.size))

    def _draw(self, key: Any, shape: tuple[int, int]) -> jax.Array:
        if self.inputs is None:
            return _xavier(key, shape)
        return _xavier(key, (self.inputs.total, self.size))[np.array(self.inputs.kept)]


class LayerNorm(nn.Module):
    """As `flax.linen.LayerNorm`."""

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        scale = self.param("scale", nn.initializers.ones, (x.shape[-1],))
        bias = self.param("bias", nn.initializers.zeros, (x.shape[-1],))
        normal = nn.LayerNorm(use_scale=False, use_bias=False)(x)
        return normal * to_all(scale, x.shape) + to_all(bias, x.shape)


class HiddenLayers(nn.Module):
    """Linear layers, each with dropout and layer normalisation if asked for, and activation."""

    config: LearnerConfig
    inputs: Inputs
    dropout: float = 0.0
    layer_norm: bool = False

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        for i, size in enumerate(self.config.hidden_sizes):
            x = Linear(size, None if i else self.inputs, name=f"hidden_{i}")(x)
            if self.dropout:
                x = Dropout(self.dropout)(x)
            if self.layer_norm:
                x = LayerNorm()(x)
            x = _ACTIVATIONS[self.config.activation](x)
        return x


class Actor(nn.Module):
    """Observations (..., D) to mean and logarithm of the deviation of actions (..., A) each.

    An action is the hyperbolic tangent of what is drawn from that normal distribution.
    """

    config: LearnerConfig
    inputs: Inputs
    action_size: int

    @nn.compact
    def __call__(self, observation: jax.Array) -> tuple[jax.Array, jax.Array]:
        hidden = HiddenLayers(self.config, self.inputs)(observation)
        mean = Linear(self.action_size, name="mean")(hidden)
        log_std = Linear(self.action_size, name="log_std")(hidden)
        return mean, jnp.clip(log_std, self.config.log_std_min, self.config.log_std_max)


class Critic(nn.Module):
    """Observations (..., D) and actions (..., A) to values (...)."""

    config: LearnerConfig
    inputs: Inputs
    """Of observations and actions together."""

    @nn.compact
    def __call__(self, observation: jax.Array, action: jax.Array) -> jax.Array:
        both = jnp.concatenate([observation, action], axis=-1)
        config = self.config
        hidden = HiddenLayers(config, self.inputs, config.dropout, config.layer_norm)(both)
        return Linear(1, name="value")(hidden)[..., 0]
