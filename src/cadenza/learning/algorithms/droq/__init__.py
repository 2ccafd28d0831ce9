"""DroQ: soft actor-critic with dropout and layer normalisation in the critics."""
