"""Choose between the rows of arrays on JAX's device; each environment has a row."""

from typing import Any

import jax
import jax.numpy as jnp

Array = Any  # of NumPy or of JAX


def rows_of(mask: Array, values: Array) -> Array:
    """A mask (N,) in the shape (N, 1, ...), which has the dimensions of `values`."""
    return mask.reshape(mask.shape + (1,) * (values.ndim - 1))


def where(mask: Array, first: Any, second: Any) -> Any:
    """The rows of the first of two trees of arrays (N, ...) where the mask (N,) is set."""
    return jax.tree.map(lambda a, b: jnp.where(rows_of(mask, b), a, b), first, second)
