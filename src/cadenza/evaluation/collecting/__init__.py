"""Collecting demonstrations: many varied episodes of many songs."""
