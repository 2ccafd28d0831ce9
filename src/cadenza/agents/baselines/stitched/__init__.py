"""Plays songs open loop, from motions that are planned once and stitched together."""
