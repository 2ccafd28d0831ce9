"""Runs of songs x agents x seeds: planned, carried out and summed up."""
