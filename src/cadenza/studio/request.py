"""What a visitor of the studio can ask for. Imports nothing heavy: the server reads it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadenza.configs import MOST_COUNT, check_ranges
from cadenza.errors import CadenzaError
from cadenza.files import checked

if TYPE_CHECKING:
    from cadenza.music.score import Score

_MOST_TRACKS = 1 << 16  # in a file, as the header of MIDI can count
TOLD, ROWS = "live.json", "live.rows"
"""Files of a performance, with what was told while it was played."""
PRACTISED, SIGHT = "practised", "sight"
PLANNERS = PRACTISED, SIGHT
"""Agents of `AGENTS` that are the planner under another name."""
AGENTS = {
    "planner": ("Planner", "Plans fingers and motions, and refines them while it plays."),
    "generalist": ("Generalist", "The plan, corrected by networks, without a search; quick."),
    PRACTISED: (
        "Planner, practising",
        "Plays, then practises in the background: next time better.",
    ),
    SIGHT: ("Planner, unrefined", "The plan as it is: it takes less time, and misses more."),
    "pretrained": ("Learnt policy", "Learnt from scratch; it knows a few of the bundled pieces."),
    "predictive-sampling": ("Predictive sampling", "For contrast: a search without a plan."),
}
"""Those who play anywhere: what they are called on the page, and what they do. "sight" follows the
plan as it is; "practised" plays what has been practised before, and goes on practising."""


@dataclass(frozen=True)
class PlayRequest:
    """A song and how it is to be played."""

    song: str
    """The name of a bundled piece, or the id of an upload."""
    agent: str = "planner"
    """One of those that the studio offers, any on the command line."""
    tempo: float = 1.0
    """2 is twice as fast as written."""
    transpose: int = 0
    """[semitones]"""
    tracks: tuple[int, ...] = ()
    """Numbers of those to be played, all where none is given."""
    hand: str = "shadow"
    """The same."""
    seed: int = 0


@dataclass(frozen=True)
class Order:
    """What the process that plays is told."""

    request: PlayRequest
    title: str
    source: str
    """The name of a bundled piece, or the path of an upload."""
    uploaded: bool
    id: str
    """Of the performance."""
    folder: str
    """Where it is kept."""
    video: bool = True
    agent: str = "planner"
    """Who plays, as `cadenza.performing.setup.select` takes it."""


def read_request(content: Any, agents: Collection[str], hands: Collection[str]) -> PlayRequest:
    """What is asked for, of these agents and hands.

    Raises:
        CadenzaError: it is something else, or asks for what cannot be.
    """
    try:
        request = checked(content, PlayRequest, "request")
    except CadenzaError as error:
        raise CadenzaError(str(error).partition(";")[0]) from error
    for name, known in ("agent", agents), ("hand", hands):
        if getattr(request, name) not in known:
            raise CadenzaError(f"{name}: choose from {', '.join(known)}")
    ranges: dict[str, tuple[float, float]] = {
        "tempo": (0.25, 4),
        "transpose": (-48, 48),
        "seed": (0, MOST_COUNT),
    }
    check_ranges(request, ranges)
    if len(request.tracks) > 64 or not all(0 < track <= _MOST_TRACKS for track in request.tracks):
        raise CadenzaError("tracks: choose 64 or fewer, by their numbers in the file")
    return request


def performance_folder(root: Path, name: str) -> Path:
    """Where a performance is written until it is whole; nobody lists it."""
    return root / f".{name}"


def practice_folder(root: Path, request: PlayRequest, score: Score) -> Path:
    """Where what is asked for is practised, of a song that has this score now."""
    notes = [(note.start, note.end, note.pitch) for note in score.notes]
    wanted = json.dumps([asdict(request), notes], sort_keys=True)
    return root / "practised" / hashlib.sha256(wanted.encode()).hexdigest()[:16]
