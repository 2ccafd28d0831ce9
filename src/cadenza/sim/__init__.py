"""A batch of simulations stepped by a pool of threads; state in and out as arrays."""
