"""Summary of runs by agents and pieces: the data of the page, its figure and the tables."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.evaluation.caveats import by_name, caveats, usable
from cadenza.evaluation.jobs import SongFacts
from cadenza.evaluation.results import BenchResults, Result, Timing
from cadenza.evaluation.statistics import Scores, bootstrap_interval, mean, mean_interval
from cadenza.music.score import MS_PER_SECOND


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
"""Metrics of a run; NaN stands for an unknown value."""

WRONG_NOTES = {
    "extra_neighbour": "A key beside a right one",
    "extra_brushed": "of these, shorter than 60 ms",
    "extra_again": "Own key struck again",
    "extra_off_time": "Late or early",
    "extra_other": "Others",
    "missed_silent": "Missed: key does not sound",
    "missed_held": "Missed: key still down",
}
"""Kinds of extra and missed notes; those that are late or early are both."""

COMPARED = ("note_onset_f1", "f1")  # metrics in which agents are compared piece by piece
HEADLINES = ("note_onset_f1", "f1", "pooled_f1", "wall_per_music")  # metrics that are printed


class Estimate(NamedTuple):
    """A value and its 95 % interval, numbers or arrays.

    The interval of a piece is NaN with a single seed, or if every seed gave the same.
    """

    value: Any
    low: Any
    high: Any


class RunSummary(NamedTuple):
    """The run of an agent at a piece."""

    piece: int  # index of the piece
    agent: str  # its name in the summary
    metrics: Mapping[str, float]  # value of each of `METRICS`
    result: Result


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
    # How much better each other agent is than the first on what both played, in `COMPARED`
    differences: Mapping[str, Mapping[str, Estimate]]


@dataclass(frozen=True)
class BenchSummary:
    """Pieces, the agents that played them, and how well."""

    title: str
    pieces: Sequence[SongFacts]  # with the length of the music that was played
    agents: Sequence[str]  # by the number of pieces that they played, then by their scores
    runs: Sequence[RunSummary]
    # The mean over seeds of each of `METRICS`: arrays (agents, pieces), NaN without a run
    by_piece: Mapping[str, Estimate]
    groups: Sequence[Group]  # the first is that of all pieces
    # Reasons to be careful with comparisons: a line, and its cases
    caveats: Sequence[tuple[str, Sequence[str]]]


def metric_text(name: str, value: float) -> str:
    """The value of one of `METRICS` as text; a dash if it is unknown."""
    return "–" if math.isnan(value) else f"{value:z.{METRICS[name].decimals}f}".replace("-", "−")


def interval_text(name: str, estimate: Estimate) -> str:
    """Both ends of the interval as text; nothing if there is none."""
    if math.isnan(estimate.low):
        return ""
    return f"{metric_text(name, estimate.low)} to {metric_text(name, estimate.high)}"


AllScores = Mapping[str, Mapping[str, Scores]]
"""Agent -> metric -> scores (runs, pieces), NaN where a piece has fewer runs."""


def summarize(bench: BenchResults, title: str) -> BenchSummary:
    """The summary of the runs of a bench; raises CadenzaError if there is none to sum up."""
    results = usable(bench)  # in the order of `BenchSummary.runs`
    if not results:
        raise CadenzaError(f"{title}: no run is finished; run cadenza bench first")
    pieces = {result.song.name: _piece(result) for result in results}
    index = {name: i for i, name in enumerate(pieces)}
    names = _agent_names([result.agent for result in results])
    runs = [
        RunSummary(index[r.song.name], names[r.agent], run_metrics(r.metrics, r.timing), r)
        for r in results
    ]
    of_agent = {
        agent: {
            name: _scores([r for r in runs if r.agent == agent], name, len(pieces))
            for name in METRICS
        }
        for agent in dict.fromkeys(run.agent for run in runs)
    }
    agents = sorted(of_agent, key=lambda agent: _rank(of_agent[agent]))
    scores = {agent: of_agent[agent] for agent in agents}
    return BenchSummary(
        title=title,
        pieces=list(pieces.values()),
        agents=agents,
        runs=runs,
        by_piece={name: _by_piece(scores, name) for name in METRICS},
        groups=list(_groups(list(pieces.values()), scores)),
        caveats=list(caveats(bench)),
    )


def _piece(result: Result) -> SongFacts:
    song = result.song
    library = song.library or "other pieces"
    return replace(
        song,
        title=song.title or song.name,
        library=f"{library}:{song.split}" if song.split else library,
        seconds=result.timing.music_seconds,
        notes=song.notes or 0,
    )


def _agent_names(agents: Iterable[str]) -> dict[str, str]:
    """The name of each agent: for the absolute path of a folder, its end."""
    names = {agent: agent for agent in agents}
    short = {agent: Path(agent).parts[-2:] for agent in names if Path(agent).is_absolute()}
    if len(set(short.values())) == len(short):
        names |= {agent: "/".join(parts) for agent, parts in short.items()}
    return names


def run_metrics(metrics: Mapping[str, Any], timing: Timing) -> dict[str, float]:
    """All of `METRICS` from those of `cadenza play`, NaN for unknown values."""
    music = timing.music_seconds or math.nan
    shares = {name: _number(metrics.get(name)) for name in SHARES}
    return shares | {
        "extra_notes": _number(metrics.get("extra_notes_per_100")),
        "missed_notes": _number(metrics.get("missed_notes_per_100")),
        "onset_error": MS_PER_SECOND * _number(metrics.get("onset_error_median")),
        "velocity_error": _number(metrics.get("velocity_error")),
        "wall_per_music": timing.wall_seconds / music,
        "cpu_per_music": _number(timing.cpu_seconds) / music,
        "power": _number(metrics.get("energy")) / music,
    }


def wrong_notes(summary: BenchSummary) -> dict[str, list[str]]:
    """Means over the runs of each agent of its `WRONG_NOTES` in a hundred written, as text."""
    rows = dict[str, list[str]]()
    for agent in summary.agents:
        own = [run.result.metrics for run in summary.runs if run.agent == agent]
        each = np.array([[_number(m.get(f"{kind}_per_100")) for kind in WRONG_NOTES] for m in own])
        known = each[~np.isnan(each).any(axis=1)]
        rows[agent] = [f"{values.mean():.1f}" if len(values) else "–" for values in known.T]
    return rows


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


# Statistics


def _scores(runs: Sequence[RunSummary], metric: str, num_pieces: int) -> Scores:
    """A metric of the runs of an agent (runs, pieces)."""
    by_piece: list[list[float]] = [[] for _ in range(num_pieces)]
    for run in runs:
        if not math.isnan(value := run.metrics[metric]):
            by_piece[run.piece].append(value)
    rows = list(zip_longest(*by_piece, fillvalue=math.nan))
    return np.array(rows, float).reshape(-1, num_pieces)


def _played(scores: Scores) -> set[int]:
    """The indices of the pieces that have a score (runs, pieces)."""
    return set(np.flatnonzero(~np.isnan(scores).all(axis=0)).tolist())


def _rank(scores: Mapping[str, Scores]) -> tuple[float, ...]:
    """A sort key: number of pieces, note onset F1 and F1, all descending."""
    f1, onsets = scores["f1"], scores["note_onset_f1"]
    f1_pieces, onset_pieces = sorted(_played(f1)), sorted(_played(onsets))
    onset_f1 = float(mean(onsets[:, onset_pieces])) if onset_pieces else 0.0
    return -len(f1_pieces), -onset_f1, -float(mean(f1[:, f1_pieces]))


def _by_piece(scores: AllScores, metric: str) -> Estimate:
    """Means over seeds and their intervals, arrays (agents, pieces)."""
    by_agent = [_clipped_interval(agent_scores[metric], metric) for agent_scores in scores.values()]
    return Estimate(*np.stack(by_agent, axis=1))


def _clipped_interval(scores: Scores, metric: str) -> tuple[Scores, Scores, Scores]:
    value, low, high = mean_interval(scores)
    return value, low.clip(0), high.clip(max=1 if metric in SHARES else math.inf)


def _groups(pieces: Sequence[SongFacts], scores: AllScores) -> Iterator[Group]:
    """Yield groups: all pieces, those that all agents played if fewer, and each library."""
    libraries = by_name((piece.library, i) for i, piece in enumerate(pieces))
    everything = range(len(pieces))
    yield _group("All pieces" if len(libraries) > 1 else pieces[0].library, everything, scores)
    common = set.intersection(*(_played(agent_scores["f1"]) for agent_scores in scores.values()))
    if common and len(common) < len(pieces):
        yield _group("Played by all", sorted(common), scores)
    if len(libraries) > 1:
        for library, members in libraries.items():
            yield _group(library, members, scores)


def _group(name: str, pieces: Sequence[int], scores: AllScores) -> Group:
    agents = {}
    for agent, agent_scores in scores.items():
        if played := sorted(_played(agent_scores["f1"]).intersection(pieces)):
            agents[agent] = AgentSummary(
                pieces=len(played),
                runs=int(np.sum(~np.isnan(agent_scores["f1"][:, played]))),
                mean={
                    metric: _estimate(agent_scores[metric][:, played], metric) for metric in METRICS
                },
            )
    first, *others = agents
    differences = {
        agent: {name: _difference(scores, agent, first, name, pieces) for name in COMPARED}
        for agent in others
    }
    return Group(name, list(pieces), agents, differences)


def _difference(
    scores: AllScores, agent: str, other: str, metric: str, pieces: Sequence[int]
) -> Estimate:
    """How much better an agent is than another on the pieces that both played."""
    ours, theirs = (scores[each][metric] for each in (agent, other))
    common = sorted(_played(ours) & _played(theirs) & set(pieces))
    if not common:
        return Estimate(math.nan, math.nan, math.nan)
    ours, theirs = ours[:, common], theirs[:, common]
    return Estimate(float(mean(ours) - mean(theirs)), *bootstrap_interval(ours, theirs))


def _estimate(scores: Scores, metric: str) -> Estimate:
    """The mean of scores (runs, pieces) over pieces with scores, and its interval.

    The interval of a single piece is the same as in the table of pieces.
    """
    scores = scores[:, sorted(_played(scores))]
    if scores.shape[1] == 1:
        return Estimate(*(float(part[0]) for part in _clipped_interval(scores, metric)))
    if not scores.size:
        return Estimate(math.nan, math.nan, math.nan)
    return Estimate(float(mean(scores)), *bootstrap_interval(scores))
