"""The folder of a bench, and the results in it.

FOLDER/plans/HASH.json    the runs that a command has asked for
FOLDER/runs/NAME/         a run, see `cadenza.evaluation.run`
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cadenza.errors import CadenzaError
from cadenza.evaluation.job import SongFacts, key_of
from cadenza.files import checked, read_json

FORMAT: Literal[1] = 1
RESULT, FAILED, PAGE = "result.json", "failed.json", "report.html"
PLANS, RUNS = "plans", "runs"


@dataclass(frozen=True)
class Timing:
    """How long a run took."""

    wall_seconds: float
    """From its beginning to its end, but for the page; of training, all the time it took."""
    music_seconds: float
    """How much music was played."""
    threads: int
    cpu_seconds: float | None = None
    """The same as `wall_seconds`, of all threads, without waiting; not known of training."""


@dataclass(frozen=True)
class Trained:
    """What came before a policy played."""

    steps: int
    """Control steps, of all environments together."""
    seconds: float


@dataclass(frozen=True)
class ResultFile:
    """What result.json holds."""

    format: Literal[1]
    job: dict[str, Any]
    """A `cadenza.evaluation.job.JobSpec`."""
    song: SongFacts
    metrics: dict[str, int | float | bool | str | None]
    """As `cadenza play` writes them, and `energy` [J] of all actuators, if the task counts it."""
    timing: Timing
    versions: dict[str, str]
    pages: dict[str, str | None]
    """Kind -> file in the folder, or None."""
    training: Trained | None = None


@dataclass(frozen=True)
class Result(ResultFile):
    """A run that is finished."""

    folder: Path = field(kw_only=True)

    @property
    def agent(self) -> str:
        return str(self.job["agent"])

    @property
    def seed(self) -> int:
        return int(self.job["seed"])


@dataclass(frozen=True)
class Without:
    """A run that has no result."""

    name: str
    """Of its folder."""
    why: str
    """In a line."""


@dataclass(frozen=True)
class Results:
    """All runs of a folder, in the order of their names."""

    results: tuple[Result, ...]
    broken: tuple[Without, ...]
    """Whose results cannot be read."""
    unfinished: tuple[Without, ...]
    """That have failed, are under way, or have only been asked for."""


@dataclass(frozen=True)
class _Failure:
    format: Literal[1]
    error: str


@dataclass(frozen=True)
class _Plan:
    format: Literal[1]
    command: str
    runs: tuple[str, ...]


def read_results(folder: str | Path) -> Results:
    """All runs in the folder of a bench. What is corrupt is reported and left out.

    Raises:
        CadenzaError: it is not the folder of a bench.
    """
    folder = Path(folder)
    if not (folder / RUNS).is_dir():
        raise CadenzaError(f"{folder}: holds no runs; give the folder of a bench")
    results, broken, unfinished = [], [], []
    asked_for, unreadable = _asked_for(sorted((folder / PLANS).glob("*.json")))
    there = {path.name for path in (folder / RUNS).iterdir() if path.is_dir()}
    for name in sorted(there | asked_for):
        run = folder / RUNS / name
        try:
            if (run / RESULT).exists():
                results.append(read_result(run))
            else:
                unfinished.append(Without(name, failure(run) or "not finished"))
        except (CadenzaError, OSError) as error:
            broken.append(Without(name, str(error)))
    return Results(tuple(results), (*broken, *unreadable), tuple(unfinished))


def _asked_for(plans: Iterable[Path]) -> tuple[set[str], list[Without]]:
    """Names of runs, and plans that cannot be read."""
    names, unreadable = set[str](), list[Without]()
    for path in plans:
        try:
            names |= set(read_json(path, _Plan).runs)
        except (CadenzaError, OSError) as error:
            unreadable.append(Without(path.name, str(error)))
    return names, unreadable


def read_result(run: Path) -> Result:
    """Of a run that is finished.

    Raises:
        CadenzaError, OSError: it is not, its result cannot be read, or is that of another run.
    """
    path = run / RESULT
    file = read_json(path, ResultFile)
    checked({name: file.job.get(name) for name in ("song", "agent", "seed")}, _Named, path)
    if not run.name.endswith(key_of(file.job)):
        raise CadenzaError(
            f"{path}: does not belong to its folder, which was copied or renamed, or the job was "
            "changed; delete the folder"
        )
    return Result(**vars(file), folder=run)


def is_finished(run: Path) -> bool:
    """Whether there is a result that can be read; what is damaged is to be carried out again."""
    if not (run / RESULT).exists():
        return False
    try:
        read_result(run)
    except CadenzaError:
        return False
    return True


@dataclass(frozen=True)
class _Named:
    song: str
    agent: str
    seed: int


def failure(run: Path) -> str | None:
    """Why a run has failed, in a line; None if it has not.

    Raises:
        CadenzaError, OSError: that cannot be read.
    """
    path = run / FAILED
    return read_json(path, _Failure).error if path.exists() else None
