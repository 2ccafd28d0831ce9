"""Learning to play a song: DroQ, a soft actor-critic with dropout and layer normalisation."""
