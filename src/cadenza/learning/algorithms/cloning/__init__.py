"""Behaviour cloning: a perceptron that does what demonstrators did."""
