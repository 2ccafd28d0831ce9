"""Keyboards as values: which keys there are, where they lie, and how they move."""
