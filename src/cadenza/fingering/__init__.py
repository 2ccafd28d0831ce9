"""The search for a fingering, and the difficulty of a score."""
