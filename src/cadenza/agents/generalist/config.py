"""Options of the generalist. Imports nothing heavy: the command line shows them."""

from dataclasses import dataclass, field

from cadenza.configs import names_file


@dataclass(frozen=True)
class GeneralistConfig:
    """The generalist: the planner's plan, corrected by what was learnt or rehearsed; no search."""

    weights: str | None = field(default=None, metadata=names_file())
    """File of networks that "cadenza generalist" has written. The default is the networks that come
    with Cadenza for these hands. Without any, it can only rehearse."""
    look_ahead: float | None = None
    """How far ahead it knows the score [s]. By default, it plans the whole song in advance."""
    rehearsals: int | None = None
    """How often it corrects each half second of the plan by mistakes in simulation. With 0,
    networks correct the plan instead. The default is 0 if there are networks for these hands, else
    4. At sight, it never rehearses."""
