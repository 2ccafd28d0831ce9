"""Scores: reading, writing, fingering, goals per control step, the bundled songs, metrics."""
