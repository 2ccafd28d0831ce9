"""Sums up the runs of a bench by agents and pieces."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.evaluation.caveats import caveats, usable
from cadenza.evaluation.results import PAGE, Result, Results
from cadenza.evaluation.statistics import (
    Scores,
    bootstrap_interval,
    interquartile_mean,
    mean,
    mean_interval,
    performance_profile,
)
from cadenza.report.bench_summary import (
    METRICS,
    SHARES,
    THRESHOLDS,
    AgentSummary,
    BenchSummary,
    Estimate,
    Group,
    Piece,
    Run,
)

_MS_PER_SECOND = 1000
_SEED = 0  # of the bootstrap: the same runs have the same intervals


def summarize(found: Results, title: str) -> BenchSummary:
    """Returns the summary of the runs that were found.

    Raises:
        CadenzaError: there is none that can be summed up.
    """
    results = usable(found)  # in the order of `BenchSummary.runs`
    if not results:
        raise CadenzaError(f"{title}: no run is finished; run cadenza bench first")
    pieces = {result.song.name: _piece(result) for result in results}
    index = {name: i for i, name in enumerate(pieces)}
    names = _agent_names([result.agent for result in results])
    runs = [_run(result, names, index[result.song.name]) for result in results]
    scores = _Scores(runs, len(pieces))
    agents = sorted(dict.fromkeys(run.agent for run in runs), key=scores.rank)
    groups = _groups(list(pieces.values()), agents, scores)
    return BenchSummary(
        title=title,
        pieces=list(pieces.values()),
        agents=agents,
        runs=runs,
        by_piece={name: _by_piece(scores, name, agents) for name in METRICS},
        groups=groups,
        common=_common(groups[0], agents, scores),
        caveats=list(caveats(found)),
    )


def _piece(result: Result) -> Piece:
    song = result.song
    library = song.library or "other pieces"
    return Piece(
        name=song.name,
        title=song.title or song.name,
        composer=song.composer,
        library=f"{library}:{song.split}" if song.split else library,
        difficulty=math.nan if song.difficulty is None else song.difficulty,
        seconds=result.timing.music_seconds,
        notes=song.notes or 0,
    )


def _agent_names(agents: Iterable[str]) -> dict[str, str]:
    """Returns the name of each agent: of a policy's folder given from / on, the end of its path."""
    names = {agent: agent for agent in agents}
    short = {agent: Path(agent).parts[-2:] for agent in names if Path(agent).is_absolute()}
    if len(set(short.values())) == len(short):
        names |= {agent: "/".join(parts) for agent, parts in short.items()}
    return names


def _run(result: Result, names: Mapping[str, str], piece: int) -> Run:
    page = result.folder / PAGE
    return Run(
        piece=piece,
        agent=names[result.agent],
        seed=result.seed,
        metrics=run_metrics(result),
        page=page if page.exists() else None,
    )


def run_metrics(result: Result) -> dict[str, float]:
    """Returns all of `METRICS`, NaN where one is not known."""
    music = result.timing.music_seconds or math.nan
    shares = {name: _number(result.metrics.get(name)) for name in SHARES}
    return shares | {
        "onset_error": _MS_PER_SECOND * _number(result.metrics.get("onset_error_median")),
        "velocity_error": _number(result.metrics.get("velocity_error")),
        "wall_per_music": result.timing.wall_seconds / music,
        "cpu_per_music": _number(result.timing.cpu_seconds) / music,
        "power": _number(result.metrics.get("energy")) / music,
    }


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


# Statistics


class _Scores:
    """Metrics of all runs as arrays (runs, pieces), NaN where a piece has fewer runs."""

    def __init__(self, runs: Sequence[Run], pieces: int) -> None:
        self.pieces = range(pieces)
        self._values: dict[tuple[str, str, int], list[float]] = {}
        for run in runs:
            for metric, value in run.metrics.items():
                if not math.isnan(value):
                    self._values.setdefault((metric, run.agent, run.piece), []).append(value)

    def of(self, metric: str, agent: str, pieces: Sequence[int]) -> Scores:
        of_each = [self._values.get((metric, agent, piece), []) for piece in pieces]
        return np.array(list(zip_longest(*of_each, fillvalue=math.nan)), float).reshape(
            -1, len(pieces)
        )

    def played(self, agent: str) -> set[int]:
        """Returns the indices of the pieces that it played."""
        return {piece for piece in self.pieces if ("f1", agent, piece) in self._values}

    def repeated(self, agent: str) -> set[int]:
        """Returns the indices of the pieces with several runs."""
        return {p for p in self.played(agent) if len(self._values["f1", agent, p]) > 1}

    def identical(self, agent: str) -> set[int]:
        """Returns those of the repeated pieces of which every share is the same in all runs."""
        return {
            piece
            for piece in self.repeated(agent)
            if all(len(set(self._values.get((name, agent, piece), ()))) < 2 for name in SHARES)
        }

    def rank(self, agent: str) -> tuple[int, float]:
        """Returns a sort key: first is who played the most pieces, and of these who played best."""
        played = sorted(self.played(agent))
        return -len(played), -float(mean(self.of("f1", agent, played)))


def _by_piece(scores: _Scores, metric: str, agents: Sequence[str]) -> Estimate:
    """Returns means over seeds and their intervals, arrays (agents, pieces)."""
    of_agents = [mean_interval(scores.of(metric, agent, scores.pieces)) for agent in agents]
    value, low, high = np.stack(of_agents, axis=1)
    return Estimate(value, low.clip(0), high.clip(max=1 if metric in SHARES else None))


def _groups(pieces: Sequence[Piece], agents: Sequence[str], scores: _Scores) -> list[Group]:
    """Returns all pieces, and each library if there are several."""
    libraries = list(dict.fromkeys(piece.library for piece in pieces))
    if len(libraries) == 1:
        return [_group(libraries[0], range(len(pieces)), agents, scores)]
    members = {
        library: [i for i, piece in enumerate(pieces) if piece.library == library]
        for library in libraries
    }
    everything = {"All pieces": list(range(len(pieces)))}
    return [_group(name, of, agents, scores) for name, of in (everything | members).items()]


def _common(everything: Group, agents: Sequence[str], scores: _Scores) -> Group:
    """Returns the pieces that all agents played, or all if there are none."""
    common = sorted(set.intersection(*map(scores.played, agents)))
    if not common or len(common) == len(everything.pieces):
        return everything
    return _group("Played by all", common, agents, scores)


def _group(name: str, pieces: Sequence[int], agents: Sequence[str], scores: _Scores) -> Group:
    summaries = {}
    for agent in agents:
        if played := sorted(scores.played(agent).intersection(pieces)):
            summaries[agent] = _agent_summary(agent, played, scores)
    return Group(name, list(pieces), summaries)


def _agent_summary(agent: str, pieces: Sequence[int], scores: _Scores) -> AgentSummary:
    estimates = {name: _estimates(scores.of(name, agent, pieces), name) for name in METRICS}
    return AgentSummary(
        pieces=len(pieces),
        runs=int(np.sum(~np.isnan(scores.of("f1", agent, pieces)))),
        repeated=len(scores.repeated(agent).intersection(pieces)),
        identical=len(scores.identical(agent).intersection(pieces)),
        mean={name: Estimate(*(part[0] for part in each)) for name, each in estimates.items()},
        iqm={name: Estimate(*(part[1] for part in each)) for name, each in estimates.items()},
        profile={name: Estimate(*(part[2:] for part in estimates[name])) for name in SHARES},
    )


def _estimates(scores: Scores, metric: str) -> Estimate:
    """Returns arrays of the mean, the interquartile mean and of shares the profile (2 + n,).

    One bootstrap serves all of them.
    """
    scores = scores[:, ~np.isnan(scores).all(axis=0)] if scores.size else scores
    if not scores.size:
        unknown = np.full(2 + len(THRESHOLDS), math.nan)
        return Estimate(unknown, unknown, unknown)

    def statistic(of: Scores) -> Scores:
        summed = np.stack([mean(of), interquartile_mean(of)], axis=-1)
        if metric not in SHARES:
            return summed
        return np.concatenate([summed, performance_profile(of, THRESHOLDS)], axis=-1)

    rng = np.random.default_rng(_SEED)
    return Estimate(statistic(scores), *bootstrap_interval(statistic, scores, rng))
