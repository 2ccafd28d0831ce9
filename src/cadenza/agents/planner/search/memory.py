"""What a hand remembers of the steps that it has played, so that it can go on as it would have."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SearchState(NamedTuple):
    """What decides how a hand goes on, beside where it is."""

    correction: Array
    """(H, A) to the plan, of the steps that are looked ahead."""
    savings: Array
    """() control steps that it may simulate."""
    rng: NDArray[np.uint64]
    """(6,) where its generator of random numbers is."""


def words_of(rng: np.random.Generator) -> NDArray[np.uint64]:
    """(6,) the state of a default generator, in words of 64 bits."""
    state: Any = rng.bit_generator.state
    numbers = [state["state"]["state"], state["state"]["inc"]]
    halves = [half for number in numbers for half in divmod(number, 2**64)]
    return np.array([*halves, state["has_uint32"], state["uinteger"]], np.uint64)


def generator_of(words: NDArray[np.uint64]) -> np.random.Generator:
    """The generator whose state that is."""
    state, more, inc, less, has, left = words.tolist()
    rng = np.random.default_rng(0)
    numbers = {"state": state * 2**64 + more, "inc": inc * 2**64 + less}
    known: Any = rng.bit_generator.state
    rng.bit_generator.state = known | {"state": numbers, "has_uint32": has, "uinteger": left}
    return rng
