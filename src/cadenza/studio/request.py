"""Requests to play a song, and orders to the process that plays it.

The server reads this module, so that it imports nothing heavy.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from cadenza.configs import MAX_COUNT, check_ranges
from cadenza.errors import CadenzaError
from cadenza.files import checked
from cadenza.hands.registry import HANDS
from cadenza.music.arrangement import Arrangement
from cadenza.scene.config import Hands

if TYPE_CHECKING:
    from cadenza.music.score import Score

_MAX_TRACK = 1 << 16  # number of a track, as the header of MIDI can count
_MAX_TRACKS = 64  # chosen tracks
_RANGES: dict[str, tuple[float, float]] = {
    "tempo": (0.25, 4),
    "transpose": (-48, 48),
    "seed": (0, MAX_COUNT),
}
_ID_DIGITS = 16  # digits of the name of a practice folder
# Files of a performance; earlier ones, live.json and live.rows, had other rows
HEADER_FILE, ROWS_FILE = "states.json", "states.rows"
"""Files of a performance, with the messages sent while it was played."""
PRACTISED, UNREFINED = "practised", "sight"
PLANNER_VARIANTS = PRACTISED, UNREFINED
"""Variants of the planner in `AGENTS`: the first plays practised plans and goes on practising, the
second follows the plan without refining it."""
AGENTS = {
    "planner": ("Planner", "Plans fingers and motions, and refines them while it plays."),
    "generalist": ("Generalist", "The plan, corrected by networks, without a search; quick."),
    PRACTISED: (
        "Planner, practising",
        "Plays, then practises in the background: next time better.",
    ),
    UNREFINED: ("Planner, unrehearsed", "The plan as it is: it takes less time, and misses more."),
    "pretrained": ("Learnt policy", "Trained on this song; there is one for a few bundled pieces."),
    "predictive-sampling": ("Predictive sampling", "For contrast: a search without a plan."),
}
"""Agents that play on any machine: their titles and descriptions on the page."""


@dataclass(frozen=True)
class PlayRequest:
    """A song, and options of its performance."""

    song: str  # the name of a bundled piece, or the id of an upload
    # The name of an agent that the studio offers; on the command line, of any
    agent: str = "planner"
    tempo: float = 1.0  # the speed, as a multiple of the written one
    transpose: int = 0  # the number of semitones
    tracks: tuple[int, ...] = ()  # numbers of the tracks to be played; all where none is given
    hand: str = "shadow"  # the name of a hand that the studio offers; on the command line, of any
    # Both hands, with fingers found or as written, or one hand with its own notes
    hands: Literal["both", "written", "right", "left"] = "both"
    seed: int = 0
    # Whether the notes of a score are played as they stand, without what its signs mean
    plain: bool = False
    expression: bool = False  # whether the rules of expression perform the song, with a dose of 1
    # Whether a song that the hands cannot play as written is arranged for them
    arrange: Literal["auto", "off"] = "auto"
    # The difficulty to which the song is arranged, from 1 to 10; None is as hard as it can be
    level: int | None = None

    @property
    def arrangement(self) -> Arrangement:
        """How the song is arranged and performed; raises CadenzaError for senseless options."""
        return Arrangement(
            tracks=self.tracks,
            plain=self.plain,
            arrange=self.arrange,
            level=self.level,
            expression=float(self.expression),
        )

    @property
    def playing_hands(self) -> Hands:
        """The hands that are in the scene."""
        return "both" if self.hands == "written" else self.hands


@dataclass(frozen=True)
class Order:
    """An order to the process that plays."""

    request: PlayRequest
    title: str
    source: str  # the name of a bundled piece, or the path of an upload
    uploaded: bool
    id: str  # the name of the performance
    folder: str  # the folder of the studio, where the performance is kept


def hand_titles() -> dict[str, str]:
    """The titles of the hands on the page, by their names."""
    titles = {name: entry.about.removeprefix("the ") for name, entry in HANDS.entries().items()}
    return {name: title[:1].upper() + title[1:] or name for name, title in titles.items()}


def read_request(content: Any, agents: Collection[str], hands: Collection[str]) -> PlayRequest:
    """The request that JSON holds, for one of these agents and hands.

    Raises CadenzaError if it is no such request, or an option makes no sense.
    """
    try:
        request = checked(content, PlayRequest, "request")
    except CadenzaError as error:
        raise CadenzaError(str(error).partition(";")[0]) from error
    for name, names in ("agent", agents), ("hand", hands):
        if getattr(request, name) not in names:
            raise CadenzaError(f"{name}: choose from {', '.join(names)}")
    check_ranges(request, _RANGES)
    if len(request.tracks) > _MAX_TRACKS or not all(0 < t <= _MAX_TRACK for t in request.tracks):
        raise CadenzaError(f"tracks: choose {_MAX_TRACKS} or fewer, by their numbers in the file")
    _ = request.arrangement  # raises an error if an option makes no sense
    return request


def unfinished_folder(root: Path, id: str) -> Path:
    """The hidden folder in which a performance is written until it is complete."""
    return root / f".{id}"


def practice_folder(root: Path, request: PlayRequest, score: Score) -> Path:
    """The folder in which a request is practised, for a song that has this score now."""
    notes = [(note.start, note.end, note.pitch) for note in score.notes]
    text = json.dumps([asdict(request), notes], sort_keys=True)
    return root / "practised" / hashlib.sha256(text.encode()).hexdigest()[:_ID_DIGITS]
