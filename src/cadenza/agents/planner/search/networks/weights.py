"""The networks that correct a hand's plan, and the files of their weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Ids
from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, INTEGERS, ArrayOf, read_arrays, write_atomically
from cadenza.scene.servos import clip

Floats = NDArray[np.float32]

NETWORKS = ("hand", "thumb", "fingers")
"""The networks: for the servos of the whole hand, for its thumb, and for all other fingers."""
STRIKING = ("striking thumb", "striking fingers")
"""The networks for the touch of fingers that strike, in files that have them."""
_LAYERS = 3
INPUT_LIMIT = 6.0  # normalised inputs are clipped here, beyond which there was no training data
CONSTANTS = np.array([0.0, 1.0], np.float32)
"""Inputs that follow those of the hand, for fingers without some of these."""


def _expected() -> dict[str, ArrayOf]:
    """The arrays of a file by name, with shapes that fit together within each network."""
    arrays = {"sizes": ArrayOf(INTEGERS, (2,), needed=True)}
    for of in (*NETWORKS, *STRIKING):
        needed, count = of in NETWORKS, f"{of} networks"
        arrays[f"{of}:inputs"] = ArrayOf(INTEGERS, (f"{of}", f"{of} 0"), needed)
        arrays[f"{of}:servos"] = ArrayOf(INTEGERS, (f"{of}", f"{of} {_LAYERS}"), needed)
        for name in ("middle", "spread"):
            arrays[f"{of}:{name}"] = ArrayOf(FLOATS, (f"{of} 0",), needed, finite=True)
        for i in range(_LAYERS):
            kernel = (count, f"{of} {i}", f"{of} {i + 1}")
            arrays[f"{of}:kernel{i}"] = ArrayOf(FLOATS, kernel, needed, finite=True)
            bias = (count, 1, f"{of} {i + 1}")
            arrays[f"{of}:bias{i}"] = ArrayOf(FLOATS, bias, needed, finite=True)
    return arrays


class Network(NamedTuple):
    """An ensemble of N networks for M parts of a hand that are alike, such as its fingers.

    Their outputs are averaged.
    """

    inputs: Ids  # (M, I) the inputs of each part, among those of the hand and `CONSTANTS`
    # (M, O) the outputs of each part among those of the hand: servos, or touches of fingers
    servos: Ids
    mean: Floats  # (I,) the mean of the inputs in training
    # (I,) the standard deviation of the inputs in training, by which they are normalised
    std: Floats
    kernels: tuple[Floats, ...]  # (N, I, H), ... (N, H, O)
    biases: tuple[Floats, ...]  # (N, 1, H), ... (N, 1, O)

    def __call__(self, inputs: Floats) -> Floats:
        """(H, M, O) the outputs for the inputs of H hands (H, D + 2), with `CONSTANTS`."""
        rows = inputs[:, self.inputs].reshape(-1, len(self.mean))
        hidden = clip((rows - self.mean) / self.std, -INPUT_LIMIT, INPUT_LIMIT)
        for kernel, bias in zip(self.kernels[:-1], self.biases[:-1], strict=True):
            hidden = np.maximum(hidden @ kernel + bias, 0.0)
        outputs: Floats = (hidden @ self.kernels[-1] + self.biases[-1]).mean(axis=0)
        return outputs.reshape(len(inputs), *self.servos.shape)


class Weights(NamedTuple):
    """Networks that map D inputs of a hand to A outputs, one for each servo."""

    sizes: tuple[int, int]  # D and A
    networks: tuple[Network, ...]
    # Networks for the touch of fingers that strike; may be missing
    striking: tuple[Network, ...] = ()

    @classmethod
    def load(cls, path: Path) -> Weights:
        """Read the networks of a file; raises CadenzaError if it is missing or damaged."""
        weights = cls.of(read_arrays(path, _expected()))
        (num_inputs, servos), networks, striking = weights
        inputs = np.concatenate([network.inputs.ravel() for network in (*networks, *striking)])
        outputs = np.sort(np.concatenate([network.servos.ravel() for network in networks]))
        inside = (inputs >= 0) & (inputs < num_inputs + len(CONSTANTS))
        if not (inside.all() and np.array_equal(outputs, np.arange(servos))):
            raise CadenzaError(
                f"{path}: its networks do not fit {num_inputs} inputs and {servos} servos; "
                "fit them again with cadenza generalist clone"
            )
        return weights

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> Weights:
        """The networks of the property `arrays`."""
        num_inputs, servos = arrays["sizes"].tolist()
        networks = tuple(_network(arrays, of) for of in NETWORKS)
        striking = tuple(_network(arrays, of) for of in STRIKING if f"{of}:inputs" in arrays)
        return cls((num_inputs, servos), networks, striking)

    def save(self, path: Path) -> None:
        """Write the networks to a file, for `load`."""
        with write_atomically(path) as file:
            np.savez(file, allow_pickle=False, **self.arrays)

    @property
    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """The arrays of a file, by name."""
        arrays: dict[str, NDArray[np.generic]] = {"sizes": np.array(self.sizes)}
        networks = *self.networks, *self.striking
        for of, network in zip((*NETWORKS, *STRIKING), networks, strict=False):
            arrays[f"{of}:inputs"] = network.inputs.astype(np.int16)
            arrays[f"{of}:servos"] = network.servos.astype(np.int16)
            arrays[f"{of}:middle"], arrays[f"{of}:spread"] = network.mean, network.std
            for kind, layers in (("kernel", network.kernels), ("bias", network.biases)):
                for i, layer in enumerate(layers):
                    arrays[f"{of}:{kind}{i}"] = layer.astype(np.float16)
        return arrays

    def __call__(self, inputs: Floats) -> Floats:
        """(A,) the outputs for the inputs (D,) of a hand, or (H, A) for several hands (H, D)."""
        return _outputs(self.networks, inputs, self.sizes[1])

    def touch(self, inputs: Floats) -> Floats:
        """(H, F, 2) the touch of fingers that strike, for the inputs (H, D) of hands."""
        count = sum(network.servos.size for network in self.striking)
        return _outputs(self.striking, inputs, count).reshape(len(inputs), -1, 2)


def _network(arrays: Mapping[str, NDArray[Any]], of: str) -> Network:
    kernels, biases = (
        tuple(arrays[f"{of}:{kind}{i}"].astype(np.float32) for i in range(_LAYERS))
        for kind in ("kernel", "bias")
    )
    return Network(
        arrays[f"{of}:inputs"].astype(np.intp),
        arrays[f"{of}:servos"].astype(np.intp),
        arrays[f"{of}:middle"].astype(np.float32),
        arrays[f"{of}:spread"].astype(np.float32),
        kernels,
        biases,
    )


def _outputs(networks: Sequence[Network], inputs: Floats, count: int) -> Floats:
    """All `count` outputs (O,) of networks for inputs (D,), or (H, O) for (H, D)."""
    inputs, shape = np.atleast_2d(inputs), (*inputs.shape[:-1], count)
    inputs = np.concatenate([inputs, np.tile(CONSTANTS, (len(inputs), 1))], axis=1)
    outputs = np.zeros((len(inputs), count), np.float32)
    for network in networks:
        outputs[:, network.servos] = network(inputs)
    return outputs.reshape(shape)


@lru_cache
def shipped(folder: Path = Path(__file__).parent) -> dict[str, Weights]:
    """Name of a hand -> the networks in `folder`, by default those that come with the package."""
    return {path.stem: Weights.load(path) for path in folder.glob("*.npz")}
