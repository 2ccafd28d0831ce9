"""Training of the agent `generalist`: behaviour cloning of the planner, then PPO."""
