"""How episodes of a song differ. Imports nothing heavy: the command line shows it."""

from __future__ import annotations

from dataclasses import dataclass

from cadenza.tasks.config import TaskConfig


@dataclass(frozen=True)
class Variation:
    """What is drawn for each episode beside tempo, transposition and the place of the hands."""

    noise: float = 0.2
    """Maximum noise on what is played, where 1 is the noise of the planner's search. How much is
    drawn per episode. The recorded actions have none, and correct what the noise before them
    did."""
    mirror: bool = True
    """Mirror half of the episodes about D4: each hand plays what the other would."""
    excerpt: float | None = None
    """Play so many seconds [s] from somewhere in the song, instead of all of it."""
    student: str | None = None
    """Another agent, which plays half of the time, in stretches of about a second. What is recorded
    is what the first agent would have played in its place."""


def varied() -> TaskConfig:
    """Returns the task of collecting, unless something else is chosen."""
    return TaskConfig(
        initial_buffer_time=0.5,
        random_stretch=0.2,
        random_pitch_shift=3,
        random_hand_position=0.05,
    )
