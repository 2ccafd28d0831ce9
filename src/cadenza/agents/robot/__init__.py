"""Practice with a robot of unknown parameters, real or simulated."""
