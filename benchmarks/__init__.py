"""Benchmarks: commands that measure, never tests."""

import cadenza  # noqa: F401 - before any of them imports NumPy, and so as commands do
