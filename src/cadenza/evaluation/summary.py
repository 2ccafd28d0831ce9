"""Sums up runs by agents and pieces."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.evaluation.caveats import caveats, usable
from cadenza.evaluation.results import PAGE, BenchResults, Result, Timing
from cadenza.evaluation.statistics import Scores, bootstrap_interval, mean, mean_interval
from cadenza.music.score import MS_PER_SECOND
from cadenza.report.bench_summary import (
    METRICS,
    SHARES,
    AgentSummary,
    BenchSummary,
    Estimate,
    Group,
    PieceSummary,
    RunSummary,
)

AllScores = Mapping[str, Mapping[str, Scores]]
"""Agent -> metric -> scores (runs, pieces), NaN where a piece has fewer runs."""


def summarize(bench: BenchResults, title: str) -> BenchSummary:
    """Return the summary of the runs of a bench; raises CadenzaError if there is none to sum up."""
    results = usable(bench)  # in the order of `BenchSummary.runs`
    if not results:
        raise CadenzaError(f"{title}: no run is finished; run cadenza bench first")
    pieces = {result.song.name: _piece(result) for result in results}
    index = {name: i for i, name in enumerate(pieces)}
    names = _agent_names([result.agent for result in results])
    runs = [_run(result, names, index[result.song.name]) for result in results]
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


def _piece(result: Result) -> PieceSummary:
    song = result.song
    library = song.library or "other pieces"
    return PieceSummary(
        name=song.name,
        title=song.title or song.name,
        composer=song.composer,
        library=f"{library}:{song.split}" if song.split else library,
        difficulty=math.nan if song.difficulty is None else song.difficulty,
        seconds=result.timing.music_seconds,
        notes=song.notes or 0,
    )


def _agent_names(agents: Iterable[str]) -> dict[str, str]:
    """Return the name of each agent: of a policy's folder given from / on, the end of its path."""
    names = {agent: agent for agent in agents}
    short = {agent: Path(agent).parts[-2:] for agent in names if Path(agent).is_absolute()}
    if len(set(short.values())) == len(short):
        names |= {agent: "/".join(parts) for agent, parts in short.items()}
    return names


def _run(result: Result, names: Mapping[str, str], piece: int) -> RunSummary:
    page = result.folder / PAGE
    return RunSummary(
        piece=piece,
        agent=names[result.agent],
        seed=result.seed,
        metrics=run_metrics(result.metrics, result.timing),
        page=page if page.exists() else None,
    )


def run_metrics(metrics: Mapping[str, Any], timing: Timing) -> dict[str, float]:
    """Return all of `METRICS` from those of `cadenza play`, NaN where one is not known."""
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


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


# Statistics


def _scores(runs: Sequence[RunSummary], metric: str, num_pieces: int) -> Scores:
    """Return a metric of the runs of an agent (runs, pieces)."""
    by_piece: list[list[float]] = [[] for _ in range(num_pieces)]
    for run in runs:
        if not math.isnan(value := run.metrics[metric]):
            by_piece[run.piece].append(value)
    rows = list(zip_longest(*by_piece, fillvalue=math.nan))
    return np.array(rows, float).reshape(-1, num_pieces)


def _played(scores: Scores) -> set[int]:
    """Return the indices of the pieces that have a score (runs, pieces)."""
    return set(np.flatnonzero(~np.isnan(scores).all(axis=0)).tolist())


def _rank(scores: Mapping[str, Scores]) -> tuple[float, ...]:
    """Return a sort key: the most pieces first, then the best note onset F1, then the best F1."""
    f1, onsets = scores["f1"], scores["note_onset_f1"]
    played, known = sorted(_played(f1)), sorted(_played(onsets))
    heard = float(mean(onsets[:, known])) if known else 0.0
    return -len(played), -heard, -float(mean(f1[:, played]))


def _by_piece(scores: AllScores, metric: str) -> Estimate:
    """Return means over seeds and their intervals, arrays (agents, pieces)."""
    of_agents = [_of_each_piece(own[metric], metric) for own in scores.values()]
    return Estimate(*np.stack(of_agents, axis=1))


def _of_each_piece(scores: Scores, metric: str) -> tuple[Scores, Scores, Scores]:
    value, low, high = mean_interval(scores)
    return value, low.clip(0), high.clip(max=1 if metric in SHARES else math.inf)


def _groups(pieces: Sequence[PieceSummary], scores: AllScores) -> Iterator[Group]:
    """Yield all pieces, those that all agents played if they are fewer, and several libraries."""
    libraries: dict[str, list[int]] = {}
    for i, piece in enumerate(pieces):
        libraries.setdefault(piece.library, []).append(i)
    everything = range(len(pieces))
    yield _group("All pieces" if len(libraries) > 1 else pieces[0].library, everything, scores)
    common = set.intersection(*(_played(own["f1"]) for own in scores.values()))
    if common and len(common) < len(pieces):
        yield _group("Played by all", sorted(common), scores)
    if len(libraries) > 1:
        for library, members in libraries.items():
            yield _group(library, members, scores)


def _group(name: str, pieces: Sequence[int], scores: AllScores) -> Group:
    agents = {}
    for agent, own in scores.items():
        if played := sorted(_played(own["f1"]).intersection(pieces)):
            agents[agent] = AgentSummary(
                pieces=len(played),
                runs=int(np.sum(~np.isnan(own["f1"][:, played]))),
                mean={metric: _estimate(own[metric][:, played], metric) for metric in METRICS},
            )
    return Group(name, list(pieces), agents)


def _estimate(scores: Scores, metric: str) -> Estimate:
    """Return the mean of scores (runs, pieces), but for pieces without any, and its interval.

    Of one piece, the interval is the same as in the table of pieces.
    """
    scores = scores[:, sorted(_played(scores))]
    if scores.shape[1] == 1:
        return Estimate(*(float(part[0]) for part in _of_each_piece(scores, metric)))
    if not scores.size:
        return Estimate(math.nan, math.nan, math.nan)
    return Estimate(float(mean(scores)), *bootstrap_interval(scores))
