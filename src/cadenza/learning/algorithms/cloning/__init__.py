"""Behaviour cloning: a perceptron that imitates demonstrators."""
