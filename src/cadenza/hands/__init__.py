"""Hands as values: bodies, fingers, servos, what they reach. A folder for each."""
