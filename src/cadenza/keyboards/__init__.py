"""Keyboards as values: the places and the motion of their keys."""
