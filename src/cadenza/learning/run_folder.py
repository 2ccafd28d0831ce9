"""A training run on disk: what it needs to go on after a kill at any moment.

RUN/run.json              what was asked for, and the versions of the libraries
RUN/checkpoints/N/        learner, environments, random generators after N control steps
RUN/replay/N.I.npz        the experience gathered up to N since the file before
RUN/metrics.jsonl         metrics, a row a line
RUN/lock                  held by the process that trains it
RUN/best/, RUN/last/      the policy that played best, and that of the last checkpoint
"""

from __future__ import annotations

import json
import math
import os
import re
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from itertools import count, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from cadenza.errors import CadenzaError
from cadenza.files import (
    ANY,
    TEMPORARY,
    Expected,
    checked,
    content_of,
    locked,
    opened_in_place,
    parsed_json,
    read_arrays,
    read_json,
    write_atomically,
)
from cadenza.learning.config import TrainingConfig, check
from cadenza.learning.learner import learner_config, name_of
from cadenza.learning.sealed_folder import read_sealed, write_sealed
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.scene.config import check_modules

_VERSIONS = ("cadenza", "mujoco", "numpy", "jax", "flax", "optax")
_KIND = "checkpoint"
_MOST_ROWS = 2**28  # bytes of metrics: half a million rows
_KEPT = 2  # should the newest be damaged, there is the one before
# Names that are written here; whatever else lies there is nobody's business.
_CHECKPOINT, _CHUNK = r"\d{12,}", r"\d{12,}\.\d+\.npz"
_UNFINISHED = rf"\.{_CHECKPOINT}\.(new|old)|\.{_CHUNK}\..*|{re.escape(TEMPORARY)}.*"

Count = Annotated[int, Meta(ge=0, le=2**53)]
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class _About:
    """What run.json holds."""

    config: TrainingConfig
    """But for the options of the learner."""
    score: WrittenScore
    versions: dict[str, str]
    id: str
    learner: str
    """Its name."""


@dataclass(frozen=True)
class Chunk:
    """Experience in a file of its own."""

    file: Annotated[str, Meta(pattern=f"^{_CHUNK}$")]
    to: tuple[Count, ...]
    """How many frames each environment has had at its end."""

    @property
    def frames(self) -> int:
        """Of all environments, since they began."""
        return sum(self.to)


@dataclass(frozen=True)
class Facts:
    """Where a run has got to, but for arrays."""

    step: Count
    seconds: float
    best: dict[str, float | None]
    """The row of the best evaluation."""
    sample_rng: dict[str, Any]
    collector: dict[str, Any]
    finished: tuple[tuple[float | None, float | None], ...]
    replay: tuple[Chunk, ...]
    ends: tuple[tuple[Count, Count], ...]
    """From which step on it was to end at which."""
    threads: int | None
    """With how many the learner added numbers up, if that is known."""
    updates: Count
    """Of the learner."""
    metrics_size: Count = 0


class Checkpoint(NamedTuple):
    """All that was kept."""

    facts: Facts
    arrays: Arrays
    replay: list[Arrays | None]
    """Of each chunk what was gathered, None where it is lost."""


class RunFolder:
    """The files of a run, for the one process that trains it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._checkpoints, self._replay = path / "checkpoints", path / "replay"
        self._about, self._metrics = path / "run.json", path / "metrics.jsonl"

    @contextmanager
    def locked(self) -> Iterator[None]:
        """While a process trains it; makes the folder.

        Raises:
            CadenzaError: another process trains this run, or nothing can be written there.
        """
        with locked(self.path) as ours:
            if not ours:
                raise CadenzaError(f"{self.path}: another process is training this run")
            yield

    # What it is

    @property
    def begun(self) -> bool:
        """Whether it has been said what the run is."""
        return self._about.exists()

    def begin(self, config: TrainingConfig, score: Score) -> None:
        """Writes down what is asked for.

        Raises:
            CadenzaError: the folder holds a run already, or what is left of one.
        """
        if self.begun:
            raise CadenzaError(
                f"{self.path}: already holds a run; continue it with --resume {self.path}, or "
                "choose another folder with --output"
            )
        if self._saved():  # the run would go on from them, whatever is asked for
            raise CadenzaError(
                f"{self._about}: missing, but there are checkpoints; use another copy, or choose "
                "another folder with --output"
            )
        song, learner = WrittenScore.of(score), name_of(config.learner)
        about = _About(config, song, _versions(), secrets.token_hex(8), learner)
        self._write(about)

    def forget(self) -> None:
        """Undoes `begin`, of a run that cannot be made: the folder is free for another."""
        self._about.unlink(missing_ok=True)

    def set_end(self, config: TrainingConfig) -> None:
        """Has the run end as `config` says.

        Raises:
            CadenzaError: it differs in something else too, or makes no sense.
        """
        about = self._read()
        check(config)
        if replace(config, num_steps=about.config.num_steps) != about.config:
            raise CadenzaError(
                f"{self.path}: a resumed run keeps its own options; leave out all but --num-steps"
            )
        if config != about.config:
            self._write(replace(about, config=config))

    def _write(self, about: _About) -> None:
        with write_atomically(self._about) as file:
            file.write((json.dumps(asdict(about), indent=1) + "\n").encode())

    def _read(self) -> _About:
        if not self.begun:
            raise CadenzaError(f"{self.path}: holds no run to resume")
        about = read_json(self._about, dict[str, Any])
        if "demonstrations" in about:
            raise CadenzaError(
                f"{self.path}: holds a run of cadenza clone; repeat its command to continue it"
            )
        config = about.get("config")
        options = config.pop("learner", {}) if isinstance(config, dict) else {}
        read = checked(about, _About, self._about)
        learner = checked(options, learner_config(read.learner), self._about)
        return replace(read, config=replace(read.config, learner=learner))

    def settings(self) -> tuple[TrainingConfig, Score]:
        """What was asked for, to go on with it.

        Raises:
            CadenzaError: the folder holds no run, or one whose hand or keyboard is of a module that
                nobody has imported.
        """
        config, score = self.description()
        check_modules(config.scene, self._about)
        return config, score

    def description(self) -> tuple[TrainingConfig, Score]:
        """What was asked for, to be shown.

        Raises:
            CadenzaError: the folder holds no run.
        """
        about = self._read()
        try:
            return about.config, about.score.score
        except CadenzaError as error:
            raise CadenzaError(f"{self._about}: {error}") from error

    @property
    def id(self) -> str:
        """Told apart by it from all other runs, wherever they lie."""
        return self._read().id

    # Figures

    def add_row(self, row: dict[str, float]) -> None:
        """Appends a row of metrics; a number that is not finite becomes null."""
        plain = {name: finite(value) for name, value in row.items()}
        with self._room(), opened_in_place(self._metrics) as file:
            file.seek(0, os.SEEK_END)
            file.write((json.dumps(plain) + "\n").encode())
            file.flush()
            os.fsync(file.fileno())  # a checkpoint counts on all rows before it

    def rows(self) -> list[dict[str, Any]]:
        """All rows so far."""
        return read_rows(self.path)

    def _cut_rows(self, size: int) -> None:
        """Leaves the whole rows within the first `size` bytes."""
        if not self._metrics.exists():
            return
        with self._room(), opened_in_place(self._metrics) as file:
            there = file.read(size)
            file.truncate(there.rfind(b"\n") + 1)
        if len(there) < size:
            print(f"{self._metrics}: rows of metrics are missing", file=sys.stderr)

    # Checkpoints

    def save_gathered(self, step: int, gathered: Arrays) -> str:
        """Keeps the experience since the last checkpoint; returns the name of its file."""
        names = (f"{step:012}.{number}.npz" for number in count())
        # That of a checkpoint at the same step is still needed.
        name = next(name for name in names if not (self._replay / name).exists())
        with self._room(), write_atomically(self._replay / name) as file:
            np.savez(file, allow_pickle=False, **gathered)
        return name

    def save(self, facts: Facts, arrays: Arrays) -> None:
        """Keeps a checkpoint, and drops what no checkpoint needs any more.

        Args:
            facts: with the chunks that `save_gathered` named; `metrics_size` is found here.
            arrays: of the run.

        Raises:
            CadenzaError: there is no room; the checkpoint before this is still there.
        """
        size = self._metrics.stat().st_size if self._metrics.exists() else 0
        with self._room():
            folder = self._checkpoints / f"{facts.step:012}"
            write_sealed(folder, _KIND, asdict(replace(facts, metrics_size=size)), arrays)
        for old in self._saved()[:-_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
        needed: set[str] = set()
        for folder in self._saved():
            try:
                needed |= {chunk.file for chunk in _facts(folder)[0].replay}
            except CadenzaError:
                return  # what a damaged one needs is not known
        for path in self._named(self._replay, _CHUNK):
            if path.name not in needed:
                path.unlink()

    def load(self, expected: Expected = ANY) -> Checkpoint | None:
        """Of the checkpoints that are whole the one from which least is lost, as a rule the newest.

        Lost is what was done since, or experience whose file is lost; both are counted in control
        steps. All that is damaged is named on standard error. Figures that were written later are
        dropped. None if there never was a checkpoint.

        Raises:
            CadenzaError: there are only damaged ones.
        """
        self._drop_unfinished()
        saved = self._saved()
        if not saved:
            self._metrics.unlink(missing_ok=True)
            return None
        found = self._found(saved, expected)
        if not found:
            raise CadenzaError(f"{self.path}: no checkpoint is intact; start a new run")
        # The older one if they lose the same.
        best = min(found, key=lambda folder: (_lost(found[folder]) - int(folder.name), folder))
        for later in saved[saved.index(best) + 1 :]:
            shutil.rmtree(later, ignore_errors=True)
        if best != saved[-1]:
            print(f"{self.path}: going back to step {int(best.name)}", file=sys.stderr)
        if lost := _lost(found[best]):
            print(f"{self.path}: up to {lost} transitions are lost", file=sys.stderr)
        self._cut_rows(found[best].facts.metrics_size)
        return found[best]

    def _found(self, saved: list[Path], expected: Expected) -> dict[Path, Checkpoint]:
        """The newest that are whole, down to one that has lost nothing."""
        found: dict[Path, Checkpoint] = {}
        chunks: dict[str, Arrays | None] = {}
        for folder in reversed(saved):
            try:
                facts, arrays = _facts(folder, expected)
            except CadenzaError as error:
                print(error, file=sys.stderr)
                continue
            names = [chunk.file for chunk in facts.replay]
            chunks |= {name: self._chunk(name) for name in names if name not in chunks}
            found[folder] = Checkpoint(facts, arrays, [chunks[name] for name in names])
            if not _lost(found[folder]):
                break
        return found

    def _chunk(self, name: str) -> Arrays | None:
        try:
            return read_arrays(self._replay / name, ANY)
        except CadenzaError as error:
            print(error, file=sys.stderr)
            return None

    def _drop_unfinished(self) -> None:
        """Drops what was being written when the process was killed."""
        for aside in self._named(self._checkpoints, rf"\.{_CHECKPOINT}\.old"):
            kept = aside.with_name(aside.stem[1:])
            if not kept.exists():  # the process was killed between two renames
                aside.rename(kept)
        for folder in (self.path, self._checkpoints, self._replay):
            for path in self._named(folder, _UNFINISHED):
                if path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    with suppress(OSError):
                        path.unlink()

    def _saved(self) -> list[Path]:
        return sorted(path for path in self._named(self._checkpoints, _CHECKPOINT) if path.is_dir())

    @staticmethod
    def _named(folder: Path, pattern: str) -> list[Path]:
        there = folder.iterdir() if folder.is_dir() else ()
        return [path for path in there if re.fullmatch(pattern, path.name, re.ASCII)]

    @contextmanager
    def _room(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CadenzaError(
                f"{self.path}: could not be written ({error.strerror}); the last checkpoint "
                f"can still be loaded. Once there is room: cadenza train --resume {self.path}"
            ) from error


def _versions() -> dict[str, str]:
    """Of the libraries that are there."""
    versions = {}
    for name in _VERSIONS:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return versions


def _facts(folder: Path, expected: Expected = MappingProxyType({})) -> tuple[Facts, Arrays]:
    plain, arrays = read_sealed(folder, _KIND, expected)
    return checked(plain, Facts, folder / "facts.json"), arrays


def _lost(checkpoint: Checkpoint) -> int:
    """Frames in chunks that are lost."""
    ends = [0, *(chunk.frames for chunk in checkpoint.facts.replay)]
    return sum(
        end - start
        for (start, end), chunk in zip(pairwise(ends), checkpoint.replay, strict=True)
        if chunk is None
    )


def finite(value: float) -> float | None:
    """As JSON has it."""
    return value if math.isfinite(value) else None


_Row = dict[str, Annotated[int, Meta(ge=-(2**53), le=2**53)] | float | None]


@contextmanager
def taking_up(run: Path) -> Iterator[None]:
    """Around what goes on from the checkpoint of a run.

    Raises:
        CadenzaError: the checkpoint does not fit, which shows in many ways.
    """
    try:
        yield
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:
        raise CadenzaError(
            f"{run}: its checkpoint does not belong to this run ({error!r}); use another copy, or "
            "start a new run"
        ) from error


def read_rows(run: Path) -> list[dict[str, Any]]:
    """The rows of metrics of a run so far, each with `step` and `seconds`.

    Half a row at the end is left out, and with a remark on standard error what is no row.
    """
    path, rows, others = run / "metrics.jsonl", [], 0
    if not path.exists():
        return []
    for line in content_of(path, _MOST_ROWS).split(b"\n")[:-1]:
        try:
            row = parsed_json(line.strip(b"\0"), _Row, path)
        except CadenzaError:
            row = {}
        if {"step", "seconds"} <= {name for name, value in row.items() if value is not None}:
            rows.append(row)
        else:
            others += 1
    if others:
        print(f"{path}: skipped lines that are not rows of metrics: {others}", file=sys.stderr)
    return rows
