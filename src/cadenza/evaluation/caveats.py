"""Caveats of a comparison: runs that cannot be summed up, and differences between runs."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypeVar

from cadenza.configs import flat
from cadenza.errors import counted
from cadenza.evaluation.results import BenchResults, Result
from cadenza.files import plain
from cadenza.music.arrangement import Arrangement

_T = TypeVar("_T")
_VARIED = ("song", "song_digest", "seed", "agent")  # fields that vary among the runs of a bench
_OF_AGENT = ("config", "agent_digest")  # fields that depend on the agent
_MUSIC = {"arrangement": asdict(Arrangement()), "task": {"stretch": 1.0, "transpose": 0}}
_AS_WRITTEN = dict(flat(plain(_MUSIC)))  # options of a job that leave a piece unchanged


def usable(bench: BenchResults) -> list[Result]:
    """The results that can be summed up."""
    return [result for result in bench.results if _has_f1(result)]


def _has_f1(result: Result) -> bool:
    return isinstance(result.metrics.get("f1"), int | float)


def caveats(bench: BenchResults) -> Iterator[tuple[str, list[str]]]:
    """Yield caveats of comparing runs: a line, and its cases."""
    results = usable(bench)
    broken = [f"{run.name}: {run.reason}" for run in bench.broken]
    without = [run.folder.name for run in bench.results if not _has_f1(run)]
    broken += [f"{name}: its result holds no F1" for name in without]
    if broken:
        yield f"{counted(len(broken), 'run')} cannot be read, and {_are(broken)} left out.", broken
    if bench.unfinished:
        missing = [f"{run.name}: {run.reason}" for run in bench.unfinished]
        yield f"{counted(len(missing), 'run')} {_are(missing)} not finished.", missing
    if few := _with_fewer_runs(results):
        yield "Some agents have fewer runs.", few
    if differences := list(_differences(results)):
        yield "Versions, settings or notes differ from run to run.", differences
    if changed := _not_as_written(results):
        yield "Pieces were not played whole and as written.", changed


def _differences(results: Sequence[Result]) -> Iterator[str]:
    """Yield a line for each setting that differs among all runs, those of an agent or a piece."""
    yield from _differing([(result, _shared_settings(result)) for result in results])
    for agent, runs in by_name((result.agent, result) for result in results).items():
        yield from _differing([(run, _agent_settings(run)) for run in runs], f"{agent}: ")
    for piece, runs in by_name((result.song.name, result) for result in results).items():
        yield from _differing([(run, _notes_and_fingers(run)) for run in runs], f"{piece}: ")


def by_name(pairs: Iterable[tuple[str, _T]]) -> dict[str, list[_T]]:
    """Name -> all values that are paired with it, such as the results of each agent."""
    groups: dict[str, list[_T]] = {}
    for name, value in pairs:
        groups.setdefault(name, []).append(value)
    return groups


def _shared_settings(result: Result) -> dict[str, Any]:
    left_out = (*_VARIED, *_OF_AGENT)
    job = {name: value for name, value in result.job.items() if name not in left_out}
    return {**result.versions, "threads": result.timing.threads, **dict(flat(job))}


def _agent_settings(result: Result) -> dict[str, Any]:
    settings = dict(flat({name: value for name, value in result.job.items() if name in _OF_AGENT}))
    if result.training is not None:
        settings.pop("config.seed", None)  # that of the run
    return settings


def _notes_and_fingers(result: Result) -> dict[str, Any]:
    fingers = result.metrics.get("rewarded_fingers")
    return {"notes": result.job.get("song_digest"), "rewarded_fingers": fingers}


def _differing(
    settings: Sequence[tuple[Result, Mapping[str, Any]]], about: str = ""
) -> Iterator[str]:
    """Yield a line for each name whose value differs among runs, with the agents of each value."""
    for name in dict.fromkeys(name for _, values in settings for name in values):
        by_value = by_name(
            ("not set" if (value := values.get(name)) is None else str(value), result.agent)
            for result, values in settings
        )
        if len(by_value) > 1:
            cases = (f"{value} in {_runs_of(agents)}" for value, agents in by_value.items())
            yield f"{about}{name}: {'; '.join(cases)}"


def _runs_of(agents: Sequence[str]) -> str:
    """The number of runs of these agents, in words."""
    return f"{counted(len(agents), 'run')} ({', '.join(dict.fromkeys(agents))})"


def _not_as_written(results: Sequence[Result]) -> list[str]:
    """A line for each option that changes the music."""
    jobs = [(result.agent, dict(flat(result.job))) for result in results]
    changes = by_name(
        (f"{name} {job[name]}", agent)
        for agent, job in jobs
        for name, default in _AS_WRITTEN.items()
        if job.get(name) not in (default, None)
    )
    return [f"{change}: {_runs_of(agents)}" for change, agents in changes.items()]


def _with_fewer_runs(results: Sequence[Result]) -> list[str]:
    """A line for each agent that has fewer runs or pieces than others."""
    songs = by_name((result.agent, result.song.name) for result in results)
    all_songs = {result.song.name for result in results}
    max_runs = max(map(len, songs.values()))
    return [
        f"{agent}: {counted(len(pieces), 'run')} of {counted(len(set(pieces)), 'piece')}; "
        f"the most are {counted(max_runs, 'run')} of {counted(len(all_songs), 'piece')}"
        for agent, pieces in songs.items()
        if len(pieces) < max_runs or len(set(pieces)) < len(all_songs)
    ]


def _are(things: Collection[object]) -> str:
    return "is" if len(things) == 1 else "are"
