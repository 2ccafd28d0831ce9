"""What learners in JAX share: how it is started, networks, rates, and their states as arrays."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, TypeVar

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.learning.learner import Ends

State = TypeVar("State")  # of named tuples, tuples and dictionaries of arrays

NUM_THREADS = 2
ACTIVATIONS = {"relu": nn.relu, "gelu": nn.gelu}
xavier = nn.initializers.xavier_uniform()


def start_jax() -> int | None:
    """Starts JAX with two threads, on one core and on many, unless something has done so before.

    In which order XLA adds numbers up depends on how many threads it has, and so do the last digits
    of all that is learnt. This variable is the only way to tell it, and it asks when it starts.

    Returns:
        With how many threads it adds numbers up, if the system tells.
    """
    before = os.environ.get("NPROC")
    os.environ["NPROC"] = str(NUM_THREADS)
    jax.devices()
    del os.environ["NPROC"]
    if before is not None:
        os.environ["NPROC"] = before
    if (threads := _num_threads()) not in (None, NUM_THREADS):
        print(
            f"JAX was started before this run with {threads} threads instead of {NUM_THREADS}: "
            "results differ in their last digits from other runs with the same seed",
            file=sys.stderr,
        )
    return threads


def _num_threads() -> int | None:
    threads = Path("/proc/self/task")
    if not threads.exists():
        return None
    names = [_name(thread) for thread in threads.iterdir()]
    return names.count("tf_XLAEigen") or None


def _name(thread: Path) -> str:
    try:
        return (thread / "comm").read_text().strip()
    except OSError:  # it has just ended
        return ""


def falling(rate: float, last: float, ends: Ends) -> optax.ScalarOrSchedule:
    """A learning rate that falls evenly from `rate` to its share `last`, by updates.

    `ends` is since which update at which one it is to have fallen; the first is since 0. From each
    of the others on it falls from what it is then.
    """
    if last == 1:
        return rate
    (since, end), *moved = ends
    falls = [optax.linear_schedule(rate, rate * last, end)]
    share = 1.0
    for begin, new_end in moved:
        share = last + (share - last) * max(1 - (begin - since) / max(end - since, 1), 0.0)
        since, end = begin, new_end
        falls.append(optax.linear_schedule(rate * share, rate * last, max(end - begin, 1)))
    return optax.join_schedules(falls, [begin for begin, _ in moved])


def named_weights(layers: dict[str, dict[str, jax.Array]]) -> dict[str, NDArray[Any]]:
    """Those of a network's layers as `Perceptron` names them."""
    return {
        f"{layer}/{name}": np.asarray(array)
        for layer, arrays in layers.items()
        for name, array in arrays.items()
    }


def to_arrays(state: Any) -> dict[str, NDArray[Any]]:
    """To keep; see `from_arrays`."""
    leaves = jax.tree_util.tree_flatten_with_path(state)[0]
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def from_arrays(arrays: dict[str, NDArray[Any]], like: State) -> State:
    """The state that was kept; `like` is one of the same shapes.

    Raises:
        CadenzaError: it is not that of such a learner.
    """
    leaves, structure = jax.tree_util.tree_flatten_with_path(like)
    kinds = {jax.tree_util.keystr(path): (leaf.shape, leaf.dtype) for path, leaf in leaves}
    if kinds != {name: (array.shape, array.dtype) for name, array in arrays.items()}:
        raise CadenzaError(
            "the learner in the checkpoint is that of another run, or of another version of "
            "Cadenza; use another copy, or start a new run"
        )
    state: State = jax.tree.unflatten(
        structure, [jnp.asarray(arrays[jax.tree_util.keystr(path)]) for path, _ in leaves]
    )
    return state
