"""Hands as values: bodies, fingers, servos, reach; a module for each."""
