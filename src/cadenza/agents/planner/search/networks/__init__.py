"""Networks that correct a hand's plan, with their inputs."""
