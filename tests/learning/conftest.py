"""JAX compiles many small programs here, each of which runs for moments."""

import jax

jax.config.update("jax_disable_most_optimizations", True)
