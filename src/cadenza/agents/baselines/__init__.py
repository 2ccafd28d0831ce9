"""Planners that are there to be compared with: of the paper, and of whole songs in advance."""
