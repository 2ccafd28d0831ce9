"""What many runs say of agents and pieces: the values that pages, figure and tables are made of."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Figure(NamedTuple):
    """What is told of every run."""

    title: str
    decimals: int
    meaning: str


SHARES = {
    "f1": Figure(
        "F1", 3, "The balance of precision and recall in each control step, mean over all steps."
    ),
    "note_onset_f1": Figure(
        "Note onset F1", 3, "Whole notes: found is what begins within 50 ms of its time."
    ),
    "pooled_f1": Figure("F1, pooled", 3, "As F1, with the keys of all steps counted together."),
    "precision": Figure("Precision", 3, "Of the keys that sound, the share that should."),
    "recall": Figure("Recall", 3, "Of the keys that should sound, the share that do."),
}
"""Figures from 0 to 1, where 1 is perfect."""
FIGURES = SHARES | {
    "wall_per_music": Figure(
        "Wall time / music",
        2,
        "Seconds that a run took, with any training, for each second of music. It is longer where "
        "other programs, or other runs, kept the cores busy.",
    ),
    "cpu_per_music": Figure(
        "CPU time / music",
        2,
        "Seconds that all threads of a run computed, for each second of music; not known of "
        "policies that were trained first.",
    ),
    "power": Figure("Energy / music [W]", 1, "Of all actuators, for each second of music."),
}
"""All figures of a run. NaN is one that is not known."""

DRAWN = ("f1", "note_onset_f1", "pooled_f1")
"""What is drawn as bars."""
SAME = "Same with every seed"
"""What the number of pieces is called that were played so."""
HEADLINES = (*DRAWN, "wall_per_music")
"""What is told first."""
THRESHOLDS = np.linspace(0, 1, 51)
"""Of performance profiles."""


class Estimate(NamedTuple):
    """A figure and its 95 % interval, from NaN to NaN where there is none, as with a
    single seed or where every seed gave the same; numbers or arrays."""

    value: Any
    low: Any
    high: Any


@dataclass(frozen=True)
class Piece:
    """What was played."""

    name: str
    title: str
    composer: str
    library: str
    difficulty: float
    """1 to 10; NaN where it is not known."""
    seconds: float
    """That were played."""
    notes: int
    """That were to be played."""


@dataclass(frozen=True)
class Run:
    """What one agent with one seed made of a piece."""

    piece: int
    """Its index."""
    agent: str
    seed: int
    figures: Mapping[str, float]
    page: Path | None
    """Where it can be seen and heard."""


@dataclass(frozen=True)
class Standing:
    """How an agent does on a number of pieces."""

    pieces: int
    runs: int
    repeated: int
    """Pieces with several seeds."""
    same: int
    """Those of them of which each of `SHARES` is the same with every seed."""
    mean: Mapping[str, Estimate]
    """Of each of `FIGURES`: numbers."""
    iqm: Mapping[str, Estimate]
    """Likewise the interquartile mean."""
    profile: Mapping[str, Estimate]
    """Of each of `SHARES`: arrays, at `THRESHOLDS`."""


@dataclass(frozen=True)
class Group:
    """Pieces that are summed up together."""

    name: str
    pieces: Sequence[int]
    """Their indices."""
    standings: Mapping[str, Standing]
    """Of each agent that played any of them."""


@dataclass(frozen=True)
class Overview:
    """All that the pages tell."""

    title: str
    pieces: Sequence[Piece]
    agents: Sequence[str]
    """Those who played the most pieces first, and of these the best."""
    runs: Sequence[Run]
    of_pieces: Mapping[str, Estimate]
    """Of each of `FIGURES` the mean over seeds: arrays (agents, pieces), NaN without a run."""
    groups: Sequence[Group]
    """All pieces first."""
    fair: Group
    """The pieces that all agents played; all, if there are none."""
    remarks: Sequence[tuple[str, Sequence[str]]]
    """What to know before comparing: in a line, and each case."""


def shown(figure: str, value: float) -> str:
    """`value` of one of `FIGURES`; a dash if it is not known."""
    text = "–" if math.isnan(value) else f"{value:z.{FIGURES[figure].decimals}f}"
    return text.replace("-", "−")


def same_in_words(standing: Standing) -> str:
    """How many pieces were played the same with every seed; a dash with a single seed."""
    return f"{standing.same} of {standing.repeated}" if standing.repeated else "–"


def in_interval(figure: str, estimate: Estimate, between: str = "–") -> str:
    """From where to where it lies; nothing if that is not known."""
    if math.isnan(estimate.low):
        return ""
    return f"{shown(figure, estimate.low)}{between}{shown(figure, estimate.high)}"
