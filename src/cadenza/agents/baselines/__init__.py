"""Planners that are there to be compared with: the paper's two, and tracked key presses."""
