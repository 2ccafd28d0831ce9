"""Recorded demonstrations: what is kept of an episode, and how learners read it."""
