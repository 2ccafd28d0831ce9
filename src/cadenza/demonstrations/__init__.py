"""Recorded demonstrations: files of episodes, and batches for learners."""
