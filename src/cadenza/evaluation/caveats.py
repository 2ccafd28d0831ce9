"""Finds runs that cannot be summed up, and differences that make runs hard to compare."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from cadenza.configs import flat
from cadenza.evaluation.results import Result, Results
from cadenza.files import plain
from cadenza.music.arrangement import Arrangement
from cadenza.report.charts import counted

_VARIED = ("song", "song_digest", "seed", "agent")  # what differs among the runs of a bench
_OWN = ("config", "agent_digest")  # what each agent has of its own
_MUSIC = {"arrangement": asdict(Arrangement()), "task": {"stretch": 1.0, "transpose": 0}}
_AS_WRITTEN = dict(flat(plain(_MUSIC)))  # the options of a job with which a piece is not changed


def usable(found: Results) -> list[Result]:
    """Returns the results that can be summed up."""
    return [result for result in found.results if _has_f1(result)]


def _has_f1(result: Result) -> bool:
    return isinstance(result.metrics.get("f1"), int | float)


def caveats(found: Results) -> Iterator[tuple[str, list[str]]]:
    """Yields what to know before comparing runs: a line, and its cases."""
    results = usable(found)
    broken = [f"{run.name}: {run.reason}" for run in found.broken]
    without = [run.folder.name for run in found.results if not _has_f1(run)]
    broken += [f"{name}: its result holds no F1" for name in without]
    if broken:
        yield f"{counted(len(broken), 'run')} cannot be read, and {_are(broken)} left out.", broken
    if found.unfinished:
        missing = [f"{run.name}: {run.reason}" for run in found.unfinished]
        yield f"{counted(len(missing), 'run')} {_are(missing)} not finished.", missing
    if few := _with_fewer_runs(results):
        yield "Some agents have fewer runs.", few
    if versions := _differing([(r, r.versions) for r in results]):
        yield "Versions differ.", versions
    if settings := _differing([(r, _common_settings(r)) for r in results]):
        yield "Settings differ.", settings
    for agent in dict.fromkeys(result.agent for result in results):
        own = [(r, _own_settings(r)) for r in results if r.agent == agent]
        if settings := _differing(own):
            yield f"Settings of {agent} differ.", settings
    if fingers := _rewarded_fingers(results):
        yield "Rewards are for different fingers.", fingers
    if threads := _differing([(r, {"threads": r.timing.threads}) for r in results]):
        yield "Wall times are of different numbers of threads.", threads
    if changed := _not_as_written(results):
        yield "Pieces were not played whole and as written.", changed
    if songs := _differing_songs(results):
        yield "The notes of a piece differ from run to run.", songs


def _common_settings(result: Result) -> dict[str, Any]:
    left_out = (*_VARIED, *_OWN)
    return dict(flat({name: value for name, value in result.job.items() if name not in left_out}))


def _own_settings(result: Result) -> dict[str, Any]:
    own = dict(flat({name: value for name, value in result.job.items() if name in _OWN}))
    if result.training is not None:
        own.pop("config.seed", None)  # the run's, so it is to differ
    return own


def _differing(settings: Sequence[tuple[Result, Mapping[str, Any]]]) -> list[str]:
    """Returns a line for each name whose value is not the same in all runs, and who has which."""
    lines = []
    for name in dict.fromkeys(name for _, values in settings for name in values):
        by_value: dict[Any, list[str]] = {}
        for result, values in settings:
            value = values.get(name)
            by_value.setdefault("not set" if value is None else str(value), []).append(result.agent)
        if len(by_value) > 1:
            each = (
                f"{value} in {counted(len(agents), 'run')} ({', '.join(dict.fromkeys(agents))})"
                for value, agents in by_value.items()
            )
            lines.append(f"{name}: {'; '.join(each)}")
    return lines


def _rewarded_fingers(results: Sequence[Result]) -> list[str]:
    """Returns a line for each piece whose runs were rewarded for different fingers."""
    pieces: dict[str, list[tuple[Result, dict[str, Any]]]] = {}
    for result in results:
        fingers = {"rewarded_fingers": result.metrics.get("rewarded_fingers")}
        pieces.setdefault(result.song.name, []).append((result, fingers))
    return [f"{piece}: {line}" for piece, runs in pieces.items() for line in _differing(runs)]


def _not_as_written(results: Sequence[Result]) -> list[str]:
    """Returns a line for each option that changes the music."""
    changes: dict[str, list[str]] = {}
    for result in results:
        settings = dict(flat(result.job))
        for name, usual in _AS_WRITTEN.items():
            if (value := settings.get(name)) not in (usual, None):
                changes.setdefault(f"{name} {value}", []).append(result.agent)
    return [
        f"{what}: {counted(len(agents), 'run')} ({', '.join(dict.fromkeys(agents))})"
        for what, agents in changes.items()
    ]


def _differing_songs(results: Sequence[Result]) -> list[str]:
    digests: dict[str, set[str]] = {}
    for result in results:
        digests.setdefault(result.song.name, set()).add(str(result.job.get("song_digest")))
    return [name for name, of in digests.items() if len(of) > 1]


def _with_fewer_runs(results: Sequence[Result]) -> list[str]:
    """Returns a line for each agent that has fewer runs or pieces than others."""
    songs: dict[str, list[str]] = {}
    for result in results:
        songs.setdefault(result.agent, []).append(result.song.name)
    all_songs = {result.song.name for result in results}
    most = max(map(len, songs.values()))
    return [
        f"{agent}: {counted(len(of), 'run')} of {counted(len(set(of)), 'piece')}; "
        f"there are {len(all_songs)} pieces, and agents with {most} runs"
        for agent, of in songs.items()
        if len(of) < most or len(set(of)) < len(all_songs)
    ]


def _are(things: Collection[object]) -> str:
    return "is" if len(things) == 1 else "are"
