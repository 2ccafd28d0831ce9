"""What the runs of a bench say of agents and pieces, and what makes runs hard to compare."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.evaluation.results import Result, Results
from cadenza.evaluation.statistics import (
    Scores,
    bootstrap_interval,
    interquartile_mean,
    mean,
    mean_interval,
    performance_profile,
)
from cadenza.report.page import flat
from cadenza.report.results_page import (
    FIGURES,
    SHARES,
    THRESHOLDS,
    Estimate,
    Group,
    Overview,
    Piece,
    Run,
    Standing,
)

_UNLIKE = ("song", "song_digest", "seed", "agent")  # of a job, what is to differ
_OF_AGENT = ("config", "agent_digest")  # and what is an agent's own
_SEED = 0  # of the bootstrap: the same runs have the same intervals


def overview(found: Results, title: str) -> Overview:
    """Of the runs that were found.

    Raises:
        CadenzaError: there is none with an F1.
    """
    results = with_f1(found)
    if not results:
        raise CadenzaError(f"{title}: no run is finished; run cadenza bench first")
    pieces = {result.song.name: _piece(result) for result in results}
    index = {name: i for i, name in enumerate(pieces)}
    names = _agent_names([result.agent for result in results])
    runs = [_run(result, names, index[result.song.name]) for result in results]
    scores = _Scores(runs, len(pieces))
    agents = sorted(dict.fromkeys(run.agent for run in runs), key=scores.rank)
    groups = _groups(list(pieces.values()), agents, scores)
    return Overview(
        title=title,
        pieces=list(pieces.values()),
        agents=agents,
        runs=runs,
        of_pieces={name: _of_pieces(scores, name, agents) for name in FIGURES},
        groups=groups,
        fair=_fair(groups[0], agents, scores),
        remarks=list(remarks(found)),
    )


def with_f1(found: Results) -> list[Result]:
    """The results that are summed up, in the order of `Overview.runs`."""
    return [result for result in found.results if result.metrics.get("f1") is not None]


def _piece(result: Result) -> Piece:
    song = result.song
    library = song.library or "other pieces"
    return Piece(
        name=song.name,
        title=song.title or song.name,
        composer=song.composer,
        library=f"{library}:{song.split}" if song.split else library,
        difficulty=math.nan if song.difficulty is None else song.difficulty,
        seconds=result.timing.music_seconds if song.seconds is None else song.seconds,
        notes=song.notes or 0,
    )


def _agent_names(agents: Iterable[str]) -> dict[str, str]:
    """What agents are called: of a policy's folder that is given from / on, the end of its path."""
    names = {agent: agent for agent in agents}
    short = {agent: Path(agent).parts[-2:] for agent in names if Path(agent).is_absolute()}
    if len(set(short.values())) == len(short):
        names |= {agent: "/".join(parts) for agent, parts in short.items()}
    return names


def _run(result: Result, names: Mapping[str, str], piece: int) -> Run:
    page = result.pages.get("report")
    return Run(
        piece=piece,
        agent=names[result.agent],
        seed=result.seed,
        figures=run_figures(result),
        page=result.folder / page if page else None,
    )


def run_figures(result: Result) -> dict[str, float]:
    """Those of `FIGURES`, NaN where one is not known."""
    music = result.timing.music_seconds or math.nan
    figures = {name: _number(result.metrics.get(name)) for name in SHARES}
    return figures | {
        "wall_per_music": result.timing.wall_seconds / music,
        "power": _number(result.metrics.get("energy")) / music,
    }


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


# Figures


class _Scores:
    """Figures of all runs as arrays (runs, pieces), NaN where a piece has fewer runs."""

    def __init__(self, runs: Sequence[Run], pieces: int) -> None:
        self.pieces = range(pieces)
        self._values: dict[tuple[str, str, int], list[float]] = {}
        for run in runs:
            for figure, value in run.figures.items():
                if not math.isnan(value):
                    self._values.setdefault((figure, run.agent, run.piece), []).append(value)

    def of(self, figure: str, agent: str, pieces: Sequence[int]) -> Scores:
        of_each = [self._values.get((figure, agent, piece), []) for piece in pieces]
        return np.array(list(zip_longest(*of_each, fillvalue=math.nan)), float).reshape(
            -1, len(pieces)
        )

    def played(self, agent: str) -> set[int]:
        """Indices of pieces."""
        return {piece for piece in self.pieces if ("f1", agent, piece) in self._values}

    def rank(self, agent: str) -> tuple[int, float]:
        """The lowest is first: who played the most pieces, and of these who played best."""
        played = sorted(self.played(agent))
        return -len(played), -float(mean(self.of("f1", agent, played)))


def _of_pieces(scores: _Scores, figure: str, agents: Sequence[str]) -> Estimate:
    """Means over seeds, and their intervals: arrays (agents, pieces)."""
    of_agents = [mean_interval(scores.of(figure, agent, scores.pieces)) for agent in agents]
    value, low, high = np.stack(of_agents, axis=1)
    return Estimate(value, low.clip(0), high.clip(max=1 if figure in SHARES else None))


def _groups(pieces: Sequence[Piece], agents: Sequence[str], scores: _Scores) -> list[Group]:
    """All pieces, and each library if there are several."""
    libraries = list(dict.fromkeys(piece.library for piece in pieces))
    if len(libraries) == 1:
        return [_group(libraries[0], range(len(pieces)), agents, scores)]
    members = {
        library: [i for i, piece in enumerate(pieces) if piece.library == library]
        for library in libraries
    }
    everything = {"All pieces": list(range(len(pieces)))}
    return [_group(name, of, agents, scores) for name, of in (everything | members).items()]


def _fair(everything: Group, agents: Sequence[str], scores: _Scores) -> Group:
    """The pieces that all agents played, or all if there are none."""
    common = sorted(set.intersection(*map(scores.played, agents)))
    if not common or len(common) == len(everything.pieces):
        return everything
    return _group("Played by all", common, agents, scores)


def _group(name: str, pieces: Sequence[int], agents: Sequence[str], scores: _Scores) -> Group:
    standings = {}
    for agent in agents:
        if played := sorted(scores.played(agent).intersection(pieces)):
            standings[agent] = _standing(agent, played, scores)
    return Group(name, list(pieces), standings)


def _standing(agent: str, pieces: Sequence[int], scores: _Scores) -> Standing:
    estimates = {name: _estimates(scores.of(name, agent, pieces), name) for name in FIGURES}
    return Standing(
        pieces=len(pieces),
        runs=int(np.sum(~np.isnan(scores.of("f1", agent, pieces)))),
        mean={name: Estimate(*(part[0] for part in each)) for name, each in estimates.items()},
        iqm={name: Estimate(*(part[1] for part in each)) for name, each in estimates.items()},
        profile={name: Estimate(*(part[2:] for part in estimates[name])) for name in SHARES},
    )


def _estimates(scores: Scores, figure: str) -> Estimate:
    """Arrays: the mean, the interquartile mean, and of shares the profile, all of one bootstrap."""
    scores = scores[:, ~np.isnan(scores).all(axis=0)] if scores.size else scores
    if not scores.size:
        unknown = np.full(2 + len(THRESHOLDS), math.nan)
        return Estimate(unknown, unknown, unknown)

    def statistic(of: Scores) -> Scores:
        summed = np.stack([mean(of), interquartile_mean(of)], axis=-1)
        if figure not in SHARES:
            return summed
        return np.concatenate([summed, performance_profile(of, THRESHOLDS)], axis=-1)

    rng = np.random.default_rng(_SEED)
    return Estimate(statistic(scores), *bootstrap_interval(statistic, scores, rng))


# What makes runs hard to compare


def remarks(found: Results) -> Iterator[tuple[str, list[str]]]:
    """What to know before comparing runs: in a line, and each case."""
    without = [r for r in found.results if r.metrics.get("f1") is None]
    broken = [f"{run.name}: {run.why}" for run in found.broken]
    broken += [f"{result.folder.name}: its result holds no F1" for result in without]
    if broken:
        yield f"{_counted(broken, 'run')} cannot be read, and {_are(broken)} left out.", broken
    if found.unfinished:
        missing = [f"{run.name}: {run.why}" for run in found.unfinished]
        yield f"{_counted(missing, 'run')} {_are(missing)} not finished.", missing
    if few := _with_fewer_runs(with_f1(found)):
        yield "Some agents have fewer runs.", few
    if versions := _differing([(r, r.versions) for r in found.results]):
        yield "Versions differ.", versions
    if settings := _differing([(r, _common_settings(r)) for r in found.results]):
        yield "Settings differ.", settings
    for agent in dict.fromkeys(result.agent for result in found.results):
        own = [(r, _own_settings(r)) for r in found.results if r.agent == agent]
        if settings := _differing(own):
            yield f"Settings of {agent} differ.", settings
    if threads := _differing([(r, {"threads": r.timing.threads}) for r in found.results]):
        yield "Wall times are of different numbers of threads.", threads
    if songs := _differing_songs(found.results):
        yield "The notes of a piece differ from run to run.", songs


def _common_settings(result: Result) -> dict[str, Any]:
    left_out = (*_UNLIKE, *_OF_AGENT)
    return dict(flat({name: value for name, value in result.job.items() if name not in left_out}))


def _own_settings(result: Result) -> dict[str, Any]:
    return dict(flat({name: value for name, value in result.job.items() if name in _OF_AGENT}))


def _differing(told: Sequence[tuple[Result, Mapping[str, Any]]]) -> list[str]:
    """In a line each: what is not the same in all runs, and who has which."""
    lines = []
    for name in dict.fromkeys(name for _, values in told for name in values):
        whose: dict[Any, list[str]] = {}
        for result, values in told:
            value = values.get(name)
            whose.setdefault("not set" if value is None else str(value), []).append(result.agent)
        if len(whose) > 1:
            each = (
                f"{value} in {_counted(agents, 'run')} ({', '.join(dict.fromkeys(agents))})"
                for value, agents in whose.items()
            )
            lines.append(f"{name}: {'; '.join(each)}")
    return lines


def _differing_songs(results: Sequence[Result]) -> list[str]:
    digests: dict[str, set[str]] = {}
    for result in results:
        digests.setdefault(result.song.name, set()).add(str(result.job.get("song_digest")))
    return [name for name, of in digests.items() if len(of) > 1]


def _with_fewer_runs(results: Sequence[Result]) -> list[str]:
    """In a line for each agent that has fewer."""
    songs: dict[str, list[str]] = {}
    for result in results:
        songs.setdefault(result.agent, []).append(result.song.name)
    all_songs = {result.song.name for result in results}
    most = max(map(len, songs.values()))
    return [
        f"{agent}: {_counted(of, 'run')} of {_counted(set(of), 'piece')}; "
        f"there are {len(all_songs)} pieces, and agents with {most} runs"
        for agent, of in songs.items()
        if len(of) < most or len(set(of)) < len(all_songs)
    ]


def _counted(things: Collection[object], what: str) -> str:
    return f"{len(things):,} {what}{'' if len(things) == 1 else 's'}"


def _are(things: Collection[object]) -> str:
    return "is" if len(things) == 1 else "are"
