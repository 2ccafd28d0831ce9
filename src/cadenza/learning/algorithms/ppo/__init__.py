"""Proximal policy optimisation: a policy that is improved a little after each rollout."""
