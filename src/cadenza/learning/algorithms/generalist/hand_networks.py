"""The generalist's networks as functions of their layers, in JAX.

A network serves one or more parts of a hand that are alike: the hand as a whole, its thumb, its
other fingers. It is an ensemble of perceptrons whose outputs are averaged.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planner.search.networks.weights import CONSTANTS, INPUT_LIMIT, Network

Array = NDArray[Any]
Layers = list[tuple[Any, Any]]
"""Kernels (N, I, O) and biases (N, 1, O) of an ensemble of N perceptrons."""

_MIN_STD = 1e-3  # least deviation that normalises an input
OUTPUT_SCALE = 0.1 * np.sqrt(2)  # scale of a policy's last layer: its first corrections are small


def initial_layers(
    sizes: Sequence[int], rng: np.random.Generator, output_scale: float = np.sqrt(2)
) -> Layers:
    """Draw layers (1, I, O) of rectified units (He et al., Delving Deep into Rectifiers, 2015)."""
    gains = [np.sqrt(2)] * (len(sizes) - 2) + [output_scale]
    return [
        (
            (gain / np.sqrt(i) * rng.standard_normal((1, i, o))).astype(np.float32),
            np.zeros((1, 1, o), np.float32),
        )
        for gain, (i, o) in zip(gains, pairwise(sizes), strict=True)
    ]


def forward(layers: Layers, x: Any, dropout: float = 0.0, key: Any = None) -> Any:
    """Outputs (N, B, O) for x (1, B, I), with dropout of hidden units given a `key`."""
    for i, (kernel, bias) in enumerate(layers):
        if i:
            x = jax.nn.relu(x)
        if i and key is not None:
            key, now = jax.random.split(key)
            x *= jax.random.bernoulli(now, 1 - dropout, x.shape) / (1 - dropout)
        x = x @ kernel + bias
    return x


def joined(ensemble: Sequence[Layers]) -> Layers:
    """The layers of an ensemble, from the layers of its members."""
    layers = (zip(*layer, strict=True) for layer in zip(*ensemble, strict=True))
    return [(np.concatenate(kernels), np.concatenate(biases)) for kernels, biases in layers]


def with_constants(inputs: Array) -> Array:
    """Inputs (N, D) of hands, then the constants that networks see."""
    constants = np.broadcast_to(CONSTANTS, (len(inputs), len(CONSTANTS)))
    return np.concatenate([inputs, constants], axis=1)


def normalisation(inputs: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (I,) of a network's inputs (N, I)."""
    std = inputs.std(axis=0)
    return inputs.mean(axis=0), np.where(std < _MIN_STD, 1.0, std)


def normalised(inputs: Array, mean: Array, std: Array) -> Array:
    """Normalised inputs (N, I), within the limit."""
    return np.clip((inputs - mean) / std, -INPUT_LIMIT, INPUT_LIMIT)


def hand_outputs(layers: Layers, network: Network, inputs: Any) -> Any:
    """Outputs (B, M, O) for the M parts a network serves, from hands' inputs (B, D).

    `layers` take the place of the network's own.
    """
    inputs = jnp.concatenate([inputs, jnp.tile(CONSTANTS, (len(inputs), 1))], axis=1)
    normalised = (inputs[:, network.inputs] - network.mean) / network.std
    x = jnp.clip(normalised, -INPUT_LIMIT, INPUT_LIMIT).reshape(1, -1, len(network.mean))
    mean = forward(layers, x).mean(axis=0)
    return mean.reshape(len(inputs), len(network.inputs), -1)


def with_layers(network: Network, layers: Layers) -> Network:
    """The network with other layers."""
    kernels, biases = (tuple(map(np.asarray, each)) for each in zip(*layers, strict=True))
    return network._replace(kernels=kernels, biases=biases)
