"""A batch of simulations, stepped by threads or on a GPU; state in and out as arrays."""
