"""Agents that plan with the simulator itself."""
