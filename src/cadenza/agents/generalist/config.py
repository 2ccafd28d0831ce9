"""What can be chosen about the generalist. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass, field

from cadenza.configs import added, names_file


@dataclass(frozen=True)
class GeneralistConfig:
    """The generalist: the planner's plan, corrected by what was learnt or rehearsed; no search."""

    weights: str | None = field(default=None, metadata=names_file())
    """File of what it has learnt, as tools/train_generalist.py writes it. By default, it is what
    comes with Cadenza for these hands. Where there is nothing for them, it can only rehearse."""
    look_ahead: float | None = field(default=None, metadata=added(before=None))
    """How far ahead it knows the score [s]. By default, it plans the whole song in advance."""
    rehearsals: int | None = field(default=None, metadata=added(before=0))
    """How often it changes each half second of the plan by what went wrong in simulation, unless
    nothing does. With 0, networks correct the plan instead; that is the default where there are
    networks for these hands, and 4 is elsewhere. At sight, it never rehearses."""
