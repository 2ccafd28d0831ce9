"""Practice with a robot that nobody knows, real or simulated."""
