"""Arrangement of songs for the hands that are to play them."""
