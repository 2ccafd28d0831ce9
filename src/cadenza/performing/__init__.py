"""Performances of songs by agents, plans and practice, and their files."""
