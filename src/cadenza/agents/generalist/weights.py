"""What has been learnt, and where it is kept."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import FLOATS, ArrayOf, read_arrays
from cadenza.scene.scene import Scene

Floats = NDArray[np.float32]

_EXPECTED = {
    "kernel": ArrayOf(FLOATS, ("inputs", "answers"), needed=True, finite=True),
    "bias": ArrayOf(FLOATS, ("answers",), needed=True, finite=True),
}


class Weights(NamedTuple):
    """Answers A numbers to D inputs: a linear map."""

    kernel: Floats
    """(D, A)"""
    bias: Floats
    """(A,)"""

    @classmethod
    def load(cls, path: Path) -> Weights:
        """Raises:
        CadenzaError: the file is not there, or is damaged.
        """
        arrays = read_arrays(path, _EXPECTED)
        return cls(*(arrays[name].astype(np.float32) for name in cls._fields))

    @property
    def sizes(self) -> tuple[int, int]:
        """D and A."""
        return len(self.kernel), len(self.bias)

    def __call__(self, inputs: Floats) -> Floats:
        """(A,) the answers to inputs (D,)."""
        return inputs @ self.kernel + self.bias


def weights_of(scene: Scene) -> Weights:
    """Those that come with the package for the hands of `scene`.

    Raises:
        CadenzaError: there are none.
    """
    here, name = Path(__file__).parent, scene.hand.name
    names = sorted(path.stem for path in here.glob("*.npz"))
    if name not in names:
        raise CadenzaError(
            f"generalist: has not learnt to play with hand {name}; choose from {', '.join(names)}, "
            "or another agent"
        )
    return Weights.load(here / f"{name}.npz")
