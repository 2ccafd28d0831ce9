"""Agents: whatever chooses actions. One folder for each larger family."""
