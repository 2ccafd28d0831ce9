"""The folder of a bench, and the results in it.

FOLDER/plans/HASH.json    the runs of a command
FOLDER/runs/NAME/         a run, see `cadenza.evaluation.run`
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cadenza.errors import CadenzaError
from cadenza.evaluation.jobs import BenchJob, SongFacts, key_of
from cadenza.files import checked, read_json, write_json

FORMAT: Literal[1] = 1
RESULT, FAILED, PAGE = "result.json", "failed.json", "report.html"
PLANS, RUNS = "plans", "runs"


@dataclass(frozen=True)
class Timing:
    """Duration of a run."""

    wall_seconds: float  # wall time of the run with its training, without the page
    music_seconds: float  # length of the music that was played
    threads: int
    # CPU time of all threads in the same period; not known of training
    cpu_seconds: float | None = None


@dataclass(frozen=True)
class Trained:
    """The training of a policy before it played."""

    steps: int  # number of control steps of all environments together
    seconds: float


@dataclass(frozen=True)
class ResultFile:
    """Content of result.json."""

    format: Literal[1]
    job: dict[str, Any]  # a `cadenza.evaluation.jobs.JobSpec`
    song: SongFacts
    metrics: dict[str, int | float | bool | str | None]  # metrics of `cadenza play`
    timing: Timing
    versions: dict[str, str]
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
class _Player:
    agent: str
    seed: int


@dataclass(frozen=True)
class MissingRun:
    """A run that has no result."""

    name: str  # name of its folder
    reason: str  # reason why there is no result, in a line


@dataclass(frozen=True)
class BenchResults:
    """The runs of a folder, in the order of their names."""

    results: tuple[Result, ...]
    broken: tuple[MissingRun, ...]  # runs whose results cannot be read
    # Runs that have failed, are under way, or have only been planned
    unfinished: tuple[MissingRun, ...]


@dataclass(frozen=True)
class _Failure:
    format: Literal[1]
    error: str


@dataclass(frozen=True)
class _Plan:
    format: Literal[1]
    command: str
    runs: tuple[str, ...]


def write_plan(folder: Path, command: str, jobs: Iterable[BenchJob]) -> None:
    """Record the runs of a command, so that missing runs can be named."""
    names = [job.spec.name for job in jobs]
    plan = {"format": FORMAT, "command": command, "runs": names}
    write_json(folder / PLANS / f"{key_of(names)}.json", plan)


def read_results(folder: str | Path) -> BenchResults:
    """Read all runs in the folder of a bench. Corrupt runs are listed as broken.

    Raises CadenzaError if it is not the folder of a bench.
    """
    folder = Path(folder)
    if not (folder / RUNS).is_dir():
        raise CadenzaError(f"{folder}: holds no runs; give the folder of a bench")
    results, broken, unfinished = [], [], []
    planned, unreadable = _planned_runs(sorted((folder / PLANS).glob("*.json")))
    existing = {path.name for path in (folder / RUNS).iterdir() if path.is_dir()}
    for name in sorted(existing | planned):
        run = folder / RUNS / name
        try:
            if (run / RESULT).exists():
                results.append(read_result(run))
            else:
                unfinished.append(MissingRun(name, failure(run) or "not finished"))
        except (CadenzaError, OSError) as error:
            broken.append(MissingRun(name, str(error)))
    return BenchResults(tuple(results), (*broken, *unreadable), tuple(unfinished))


def _planned_runs(plans: Iterable[Path]) -> tuple[set[str], list[MissingRun]]:
    """Names of runs, and plans that cannot be read."""
    names, unreadable = set[str](), list[MissingRun]()
    for path in plans:
        try:
            names |= set(read_json(path, _Plan).runs)
        except (CadenzaError, OSError) as error:
            unreadable.append(MissingRun(path.name, str(error)))
    return names, unreadable


def read_result(run: Path) -> Result:
    """The result of a finished run.

    Raises CadenzaError or OSError if it is missing, cannot be read, or is that of another run.
    """
    path = run / RESULT
    file = read_json(path, ResultFile)
    if not run.name.endswith(key_of(file.job)):
        raise CadenzaError(
            f"{path}: does not belong to its folder, which was copied or renamed, or the job was "
            "changed; delete the folder"
        )
    checked({name: file.job.get(name) for name in ("agent", "seed")}, _Player, path)
    return Result(**vars(file), folder=run)


def is_finished(_job: object, run: Path) -> bool:
    """Whether a job has a result that can be read; a damaged one does not count."""
    if not (run / RESULT).exists():
        return False
    try:
        read_result(run)
    except CadenzaError:
        return False
    return True


def failure(run: Path) -> str | None:
    """The reason why a run has failed, in a line; None if it has not.

    Raises CadenzaError or OSError if the file cannot be read.
    """
    path = run / FAILED
    return read_json(path, _Failure).error if path.exists() else None
