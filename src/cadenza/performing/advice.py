"""What to try where much of a song was lost, by what went wrong most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from cadenza.agents.planner.misses import Miss
from cadenza.fingers import SIDES
from cadenza.music.arrangement import HARDEST

_BAD = 0.9  # F1 below which a song is lost in part: the mean of whole pieces is 0.92
_MANY = 0.1  # the same, of the share of notes that were missed
_OUT_OF_REACH = ("no finger", "out of reach")  # causes against which more time does not help
_SLOWER = 1.5  # times as long


def advice(
    misses: Sequence[Miss], num_notes: int, f1: float, settings: dict[str, Any], arranged: bool
) -> str | None:
    """What to try, in a line; None where a song was played well enough.

    Args:
        misses: the notes that were missed or let go early.
        num_notes: the number of notes that were to be played.
        f1: of the performance.
        settings: what was chosen for it.
        arranged: whether the song was arranged for the hands.
    """
    missed = [miss.cause for miss in misses if not miss.sounded]
    if not misses or (f1 >= _BAD and len(missed) <= _MANY * num_notes):
        return None
    said = f"{len(missed)} of {num_notes} notes were missed, {len(misses) - len(missed)} cut short"
    if arranged or 2 * sum(cause in _OUT_OF_REACH for cause in missed) <= len(missed):
        stretch = _SLOWER * settings["task"]["stretch"]
        return f"{said}, most for want of time: try a slower tempo (--stretch {stretch:g})"
    if settings["scene"]["hands"] in SIDES:
        return f"{said}, most for want of a hand: try both (--hands both)"
    return f"{said}, most out of reach: try it arranged for the hands (--level {HARDEST})"
