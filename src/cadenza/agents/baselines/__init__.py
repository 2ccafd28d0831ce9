"""Planners to compare with: those of the paper, and planners of whole songs in advance."""
