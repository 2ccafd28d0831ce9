"""What an entrant says of an entry. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class About:
    """What whoever enters says, since no run can tell it."""

    songs: str
    """Set whose songs were played, see "cadenza benchmark"."""
    track: Literal["one-song", "at-sight", "planning"]
    """What the agent may know, see "cadenza benchmark"."""
    agent: str | None = None
    """Agent of the bench. By default the only one that played these songs."""
    name: str = ""
    """Name of the row. By default that of the agent."""
    by: str = "anonymous"
    """Who enters it, and where its code is."""
    data: str = "nothing"
    """What it has learnt from."""
    hardware: str = ""
    """Processor, and GPU if one was used. By default this processor."""
    training_steps: int | None = None
    """Control steps of training or practice, for all songs together. Known of train:PRESET."""
    cpu_hours: float | None = None
    """Core hours of training or practice. Known of train:PRESET."""
    gpu_hours: float | None = None
    """Hours of a GPU."""
