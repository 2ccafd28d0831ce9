"""Arranges songs for the hands that are to play them."""
