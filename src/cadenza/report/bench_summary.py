"""The summary of many runs: the values that its page, its figure and its tables are made of."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple


class Metric(NamedTuple):
    """A measure of every run."""

    title: str
    decimals: int
    meaning: str


SHARES = {
    "note_onset_f1": Metric(
        "Note onset F1", 3, "Whole notes: found is what begins within 50 ms of its time."
    ),
    "f1": Metric(
        "F1", 3, "The balance of precision and recall in each control step, mean over all steps."
    ),
    "pooled_f1": Metric("F1, pooled", 3, "As F1, with the keys of all steps counted together."),
    "precision": Metric("Precision", 3, "Of the keys that sound, the share that should."),
    "recall": Metric("Recall", 3, "Of the keys that should sound, the share that do."),
}
"""Metrics from 0 to 1, where 1 is perfect."""
METRICS = SHARES | {
    "extra_notes": Metric(
        "Extra notes / 100",
        1,
        "Notes played for none that was written, for every hundred written: wrong ones, and those "
        "more than 50 ms late or early.",
    ),
    "missed_notes": Metric(
        "Missed notes / 100",
        1,
        "Written notes for which none was played within 50 ms, for every hundred written.",
    ),
    "onset_error": Metric(
        "Onset error [ms]",
        1,
        "Notes: the median of how far their onsets are off, apart from the delay of all of them.",
    ),
    "velocity_error": Metric(
        "Velocity error", 1, "Notes: how far their MIDI velocities are off, the mean."
    ),
    "wall_per_music": Metric(
        "Wall time / music",
        2,
        "Seconds that a run took, with any training, for each second of music. It is longer where "
        "other programs, or other runs, kept the cores busy.",
    ),
    "cpu_per_music": Metric(
        "CPU time / music",
        2,
        "Seconds that all threads of a run computed, for each second of music; not known of "
        "policies that were trained first.",
    ),
    "power": Metric("Energy / music [W]", 1, "Of all actuators, for each second of music."),
}
"""Metrics of a run; NaN stands for one that is not known."""

HEADLINES = ("note_onset_f1", "f1", "pooled_f1", "wall_per_music")  # metrics that are printed


class Estimate(NamedTuple):
    """A value and its 95 % interval, numbers or arrays.

    The interval is NaN where there is none, as with a single seed or where every seed gave the
    same.
    """

    value: Any
    low: Any
    high: Any


@dataclass(frozen=True)
class PieceSummary:
    """A piece that was played."""

    name: str
    title: str
    composer: str
    library: str
    difficulty: float  # the grade from 1 to 10; NaN where it is not known
    seconds: float  # length of the music that was played
    notes: int  # number of notes to be played


@dataclass(frozen=True)
class RunSummary:
    """The run of an agent with a seed at a piece."""

    piece: int  # index of the piece
    agent: str
    seed: int
    metrics: Mapping[str, float]  # value of each of `METRICS`
    page: Path | None  # the page on which it can be seen and heard


@dataclass(frozen=True)
class AgentSummary:
    """Results of an agent on a number of pieces."""

    pieces: int
    runs: int
    mean: Mapping[str, Estimate]  # the mean of each of `METRICS`: numbers


@dataclass(frozen=True)
class Group:
    """Pieces that are summed up together."""

    name: str
    pieces: Sequence[int]  # indices of the pieces
    agents: Mapping[str, AgentSummary]  # every agent that played any of them


@dataclass(frozen=True)
class BenchSummary:
    """Pieces, the agents that played them, and how well."""

    title: str
    pieces: Sequence[PieceSummary]
    agents: Sequence[str]  # ordered by how many pieces they played, and then by how well
    runs: Sequence[RunSummary]
    # The mean over seeds of each of `METRICS`: arrays (agents, pieces), NaN without a run
    by_piece: Mapping[str, Estimate]
    groups: Sequence[Group]  # the first is that of all pieces
    # Reasons to be careful with comparisons: a line, and its cases
    caveats: Sequence[tuple[str, Sequence[str]]]


def metric_text(name: str, value: float) -> str:
    """Return the value of one of `METRICS` as text; a dash if it is not known."""
    return "–" if math.isnan(value) else f"{value:z.{METRICS[name].decimals}f}".replace("-", "−")


def interval_text(name: str, estimate: Estimate) -> str:
    """Return both ends of the interval as text; nothing if there is none."""
    if math.isnan(estimate.low):
        return ""
    return f"{metric_text(name, estimate.low)}–{metric_text(name, estimate.high)}"
