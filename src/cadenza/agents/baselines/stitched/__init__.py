"""Songs put together from motions that are planned once, and played open loop."""
