"""JAX for learners: its start, learning rate schedules, states as arrays."""

import os
import sys
from abc import ABC, abstractmethod
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

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
    """Start JAX with two threads, on one core and on many, unless it has been started before.

    The order in which XLA sums depends on its number of threads, and so do the last digits of
    everything learnt. Only the variable NPROC sets it, which XLA reads at its start. Returns the
    number of threads, or None where the system does not tell.
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
    names = [_thread_name(thread) for thread in threads.iterdir()]
    return names.count("tf_XLAEigen") or None


def _thread_name(thread: Path) -> str:
    try:
        return (thread / "comm").read_text().strip()
    except OSError:  # it has just ended
        return ""


class StateOnJax(ABC, Generic[State]):
    """The part of a learner that draws and writes its state, a named tuple of JAX's arrays."""

    def __init__(self) -> None:
        self.num_threads = start_jax()
        self._draw = jax.jit(self._draw_state)

    @abstractmethod
    def _draw_state(self, key: jax.Array) -> State:
        """Draw the state before the first update."""

    def init(self, seed: int) -> State:
        return self._draw(jax.random.key(seed))

    def to_arrays(self, state: State) -> dict[str, NDArray[Any]]:
        return to_arrays(state)

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> State:
        return from_arrays(arrays, jax.eval_shape(self._draw_state, jax.random.key(0)))


class JaxLearner(StateOnJax[State]):
    """A `Learner` whose state is a named tuple of JAX's arrays."""

    def __init__(self) -> None:
        super().__init__()
        # One programme compiles sooner than many small ones.
        self._update_all = jax.jit(partial(jax.lax.scan, self._update), donate_argnums=0)

    @abstractmethod
    def _update(self, state: State, batch: Any) -> tuple[State, dict[str, Any]]:
        """The state after an update by a batch (B, ...), and the update's metrics."""

    def update(self, state: State, batches: Any) -> tuple[State, dict[str, Any]]:
        return self._update_all(state, batches)


def learning_rate_schedule(
    rate: float, final_fraction: float, ends: Ends
) -> optax.ScalarOrSchedule:
    """A learning rate that decays linearly from `rate` to a fraction of it, by updates.

    Each of the `ends` (`Ends`) moves the end of the decay, which goes on from its value then.
    """
    if final_fraction == 1:
        return rate
    (since, end), *moved = ends
    schedules = [optax.linear_schedule(rate, rate * final_fraction, end)]
    fraction = 1.0
    for begin, new_end in moved:
        left = max(1 - (begin - since) / max(end - since, 1), 0.0)
        fraction = final_fraction + (fraction - final_fraction) * left
        since, end = begin, new_end
        steps = max(end - begin, 1)
        schedules.append(optax.linear_schedule(rate * fraction, rate * final_fraction, steps))
    return optax.join_schedules(schedules, [begin for begin, _ in moved])


def named_weights(layers: dict[str, dict[str, jax.Array]]) -> dict[str, NDArray[Any]]:
    """The weights of a network's layers as `Perceptron` names them."""
    return {
        f"{layer}/{name}": np.asarray(array)
        for layer, arrays in layers.items()
        for name, array in arrays.items()
    }


def to_arrays(state: Any) -> dict[str, NDArray[Any]]:
    """The arrays of a state by name, for `from_arrays`."""
    leaves = jax.tree_util.tree_flatten_with_path(state)[0]
    return {jax.tree_util.keystr(path): np.asarray(leaf) for path, leaf in leaves}


def from_arrays(arrays: dict[str, NDArray[Any]], like: State) -> State:
    """The state of `to_arrays`; `like` has the same shapes.

    Raises CadenzaError if the arrays have other names, shapes or types.
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
