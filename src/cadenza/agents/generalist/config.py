"""What can be chosen about the generalist. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GeneralistConfig:
    """The generalist: the planner's plan, corrected by what was learnt from the planner."""

    weights: str | None = None
    """File of what it has learnt, as tools/train_generalist.py writes it. By default, it is what
    comes with Cadenza for these hands."""
