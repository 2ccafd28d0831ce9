"""Scores: reading and writing, goals of control steps, metrics, song libraries, etudes."""
