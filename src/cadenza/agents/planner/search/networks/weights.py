"""What has been learnt, and where it is kept."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, INTEGERS, ArrayOf, read_arrays, write_atomically
from cadenza.scene.servos import within

Floats = NDArray[np.float32]
Ids = NDArray[np.intp]

NETWORKS = ("hand", "thumb", "fingers")
"""That answer for the servos of the whole hand, of its thumb, and of the other fingers."""
_LAYERS = 3
FURTHEST = 6.0
"""Of their usual spread that numbers count as off their middle: further off, nothing is known."""
CONSTANTS = np.array([0.0, 1.0], np.float32)
"""That are there for networks beside the numbers that are told of a hand, after them."""


def _expected() -> dict[str, ArrayOf]:
    """The arrays of a file by name; only those of the same network go together."""
    arrays = {"sizes": ArrayOf(INTEGERS, (2,), needed=True)}
    for of in NETWORKS:
        arrays[f"{of}:inputs"] = ArrayOf(INTEGERS, (f"{of}", f"{of} 0"), needed=True)
        arrays[f"{of}:servos"] = ArrayOf(INTEGERS, (f"{of}", f"{of} {_LAYERS}"), needed=True)
        for name in ("middle", "spread"):
            arrays[f"{of}:{name}"] = ArrayOf(FLOATS, (f"{of} 0",), needed=True, finite=True)
        for i in range(_LAYERS):
            kernel = ("networks", f"{of} {i}", f"{of} {i + 1}")
            arrays[f"{of}:kernel{i}"] = ArrayOf(FLOATS, kernel, needed=True, finite=True)
            bias = ("networks", 1, f"{of} {i + 1}")
            arrays[f"{of}:bias{i}"] = ArrayOf(FLOATS, bias, needed=True, finite=True)
    return arrays


class Network(NamedTuple):
    """Answers for one or more parts of a hand that are alike, such as its fingers.

    These are N networks, whose answers are averaged.
    """

    inputs: Ids
    """(M, I) which of the numbers told of a hand each of M parts sees, `CONSTANTS` included."""
    servos: Ids
    """(M, O) for which they answer."""
    middle: Floats
    """(I,) of what was told while they learnt."""
    spread: Floats
    """(I,)"""
    kernels: tuple[Floats, ...]
    """(N, I, H), ... (N, H, O)"""
    biases: tuple[Floats, ...]
    """(N, 1, H), ... (N, 1, O)"""

    def __call__(self, told: Floats) -> Floats:
        """(H, M, O) the answers to what is told of H hands (H, D + 2), `CONSTANTS` included."""
        shown = told[:, self.inputs].reshape(-1, len(self.middle))
        hidden = within((shown - self.middle) / self.spread, -FURTHEST, FURTHEST)
        for kernel, bias in zip(self.kernels[:-1], self.biases[:-1], strict=True):
            hidden = np.maximum(hidden @ kernel + bias, 0.0)
        answers: Floats = (hidden @ self.kernels[-1] + self.biases[-1]).mean(axis=0)
        return answers.reshape(len(told), *self.servos.shape)


class Weights(NamedTuple):
    """Answers A numbers, one for each servo of a hand, to D that are told of it."""

    sizes: tuple[int, int]
    """D and A."""
    networks: tuple[Network, ...]

    @classmethod
    def load(cls, path: Path) -> Weights:
        """Raises:
        CadenzaError: the file is not there, or is damaged.
        """
        arrays = read_arrays(path, _expected())
        told, servos = arrays["sizes"].tolist()
        networks = tuple(
            Network(
                arrays[f"{of}:inputs"].astype(np.intp),
                arrays[f"{of}:servos"].astype(np.intp),
                arrays[f"{of}:middle"].astype(np.float32),
                arrays[f"{of}:spread"].astype(np.float32),
                *(
                    tuple(arrays[f"{of}:{kind}{i}"].astype(np.float32) for i in range(_LAYERS))
                    for kind in ("kernel", "bias")
                ),
            )
            for of in NETWORKS
        )
        seen = np.concatenate([network.inputs.ravel() for network in networks])
        answered = np.sort(np.concatenate([network.servos.ravel() for network in networks]))
        inside = (seen >= 0) & (seen < told + len(CONSTANTS))
        if not (inside.all() and np.array_equal(answered, np.arange(servos))):
            raise CadenzaError(
                f"{path}: its networks do not fit {told} inputs and {servos} servos; "
                "fit them again with tools/train_generalist.py"
            )
        return cls((told, servos), networks)

    def save(self, path: Path) -> None:
        """Writes them to a file, for `load`."""
        with write_atomically(path) as file:
            np.savez(file, allow_pickle=False, **self.arrays)

    @property
    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """What a file holds."""
        arrays: dict[str, NDArray[np.generic]] = {"sizes": np.array(self.sizes)}
        for of, network in zip(NETWORKS, self.networks, strict=True):
            arrays[f"{of}:inputs"] = network.inputs.astype(np.int16)
            arrays[f"{of}:servos"] = network.servos.astype(np.int16)
            arrays[f"{of}:middle"], arrays[f"{of}:spread"] = network.middle, network.spread
            for kind, layers in (("kernel", network.kernels), ("bias", network.biases)):
                for i, layer in enumerate(layers):
                    arrays[f"{of}:{kind}{i}"] = layer.astype(np.float16)
        return arrays

    def __call__(self, told: Floats) -> Floats:
        """(A,) the answers to what is told of a hand (D,); of several hands at once, (H, D)."""
        told, shape = np.atleast_2d(told), (*told.shape[:-1], self.sizes[1])
        told = np.concatenate([told, np.tile(CONSTANTS, (len(told), 1))], axis=1)
        answers = np.empty((len(told), self.sizes[1]), np.float32)
        for network in self.networks:
            answers[:, network.servos] = network(told)
        return answers.reshape(shape)


@lru_cache
def shipped(folder: Path = Path(__file__).parent) -> dict[str, Weights]:
    """Hand's name -> what comes with the package for it; by default, to propose to planners."""
    return {path.stem: Weights.load(path) for path in folder.glob("*.npz")}
