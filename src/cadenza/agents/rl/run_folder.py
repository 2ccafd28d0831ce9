"""A training run on disk: what it needs to go on after a kill at any moment.

RUN/run.json              what was asked for, and the versions of the libraries
RUN/checkpoints/N/        learner, environments, random generators after N control steps
RUN/replay/N.I.npz        the experience gathered up to N since the file before
RUN/metrics.jsonl         figures, a row a line
RUN/best/, RUN/last/      the policy that played best, and that of the last checkpoint
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.rl.config import TrainingConfig
from cadenza.agents.rl.sealed_folder import read_sealed, write_sealed
from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_arrays, read_json, write_atomically
from cadenza.music.score import Score

_VERSIONS = ("cadenza", "mujoco", "numpy", "jax", "flax", "optax")
_KIND = "checkpoint"
_KEPT = 2  # should the newest be damaged, there is the one before

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class _About:
    """What run.json holds."""

    config: TrainingConfig
    score: Score
    versions: dict[str, str]


class Checkpoint(NamedTuple):
    """Where a run has got to."""

    facts: dict[str, Any]
    """`step`, `replay` and `metrics_size` among them."""
    arrays: Arrays
    replay: list[Arrays]
    """What was gathered, in order."""


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
        CadenzaError: another process trains this run.
        """
        self.path.mkdir(parents=True, exist_ok=True)
        with open(self.path / "lock", "w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError as error:
                raise CadenzaError(f"{self.path}: another process is training this run") from error
            yield

    # What it is

    def begin(self, config: TrainingConfig, score: Score) -> None:
        """Writes down what is asked for.

        Raises:
            CadenzaError: the folder holds a run already.
        """
        if self._about.exists():
            raise CadenzaError(
                f"{self.path}: holds a run already; go on with --resume {self.path}, or choose "
                "another folder with --output"
            )
        about = {
            "config": asdict(config),
            "score": asdict(score),
            "versions": {name: version(name) for name in _VERSIONS},
        }
        self._write(about)

    def set_end(self, config: TrainingConfig) -> None:
        """Has the run end as `config` says.

        Raises:
            CadenzaError: it differs in something else too.
        """
        begun, _ = self.settings()
        if replace(config, num_steps=begun.num_steps) != begun:
            raise CadenzaError(
                f"{self.path}: goes on with its own options; leave out all others but --num-steps"
            )
        if config != begun:
            self._write(json.loads(self._about.read_bytes()) | {"config": asdict(config)})

    def _write(self, about: dict[str, Any]) -> None:
        with write_atomically(self._about) as file:
            file.write((json.dumps(about, indent=1) + "\n").encode())

    def settings(self) -> tuple[TrainingConfig, Score]:
        """What was asked for.

        Raises:
            CadenzaError: the folder holds no run.
        """
        if not self._about.exists():
            raise CadenzaError(f"{self.path}: holds no run to go on with")
        about = read_json(self._about, _About)
        return about.config, about.score

    # Figures

    def add_row(self, row: dict[str, float]) -> None:
        """Appends a row of figures; a number that is none becomes null."""
        plain = {name: None if value != value else value for name, value in row.items()}
        with self._room(), open(self._metrics, "a") as file:
            file.write(json.dumps(plain) + "\n")
            file.flush()
            os.fsync(file.fileno())  # a checkpoint counts on all rows before it

    def rows(self) -> list[dict[str, Any]]:
        """All rows so far."""
        return read_rows(self.path)

    # Checkpoints

    def save_gathered(self, step: int, gathered: Arrays) -> str:
        """Keeps the experience since the last checkpoint; returns the name of its file."""
        names = (f"{step:012}.{number}.npz" for number in count())
        # That of a checkpoint at the same step is still needed.
        name = next(name for name in names if not (self._replay / name).exists())
        with self._room(), write_atomically(self._replay / name) as file:
            np.savez(file, allow_pickle=False, **gathered)
        return name

    def save(self, facts: dict[str, Any], arrays: Arrays) -> None:
        """Keeps a checkpoint, and drops what no checkpoint needs any more.

        Args:
            facts: as JSON has them, among them `step` and under `replay` a list of dictionaries
                with the `file` that `save_gathered` returned.
            arrays: of the run.

        Raises:
            CadenzaError: there is no room; the checkpoint before this is still there.
        """
        size = self._metrics.stat().st_size if self._metrics.exists() else 0
        with self._room():
            folder = self._checkpoints / f"{facts['step']:012}"
            write_sealed(folder, _KIND, facts | {"metrics_size": size}, arrays)
        for old in self._saved()[:-_KEPT]:
            shutil.rmtree(old)
        needed: set[str] = set()
        for folder in self._saved():
            try:
                needed |= _files(read_sealed(folder, _KIND)[0])
            except CadenzaError:
                return  # what a damaged one needs is not known
        for path in self._replay.glob("*.npz"):
            if path.name not in needed:
                path.unlink()

    def load(self) -> Checkpoint | None:
        """The newest checkpoint that is whole, None if there never was one.

        Figures that were written after it are dropped. A damaged checkpoint is named on standard
        error.

        Raises:
            CadenzaError: there are only damaged ones.
        """
        self._drop_unfinished()
        saved = self._saved()
        for folder in reversed(saved):
            try:
                facts, arrays = read_sealed(folder, _KIND)
                replay = [
                    read_arrays(self._replay / chunk["file"], ANY) for chunk in facts["replay"]
                ]
            except CadenzaError as error:
                print(f"{error}: going back to the checkpoint before it", file=sys.stderr)
                continue
            for later in saved[saved.index(folder) + 1 :]:
                shutil.rmtree(later)
            if self._metrics.exists():
                os.truncate(self._metrics, facts["metrics_size"])
            return Checkpoint(facts, arrays, replay)
        if saved:
            raise CadenzaError(f"{self.path}: no checkpoint is whole; start a new run")
        self._metrics.unlink(missing_ok=True)
        return None

    def _drop_unfinished(self) -> None:
        """Drops what was being written when the process was killed."""
        for folder in self._checkpoints.glob(".*"):
            shutil.rmtree(folder)
        for path in self._replay.glob(".*"):
            path.unlink()

    def _saved(self) -> list[Path]:
        return sorted(p for p in self._checkpoints.glob("*") if p.name.isdigit())

    @contextmanager
    def _room(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CadenzaError(
                f"{self.path}: could not be written ({error.strerror}); the last checkpoint "
                f"still loads. Make room, then: cadenza train --resume {self.path}"
            ) from error


def _files(facts: dict[str, Any]) -> set[str]:
    return {chunk["file"] for chunk in facts["replay"]}


def read_rows(run: Path) -> list[dict[str, Any]]:
    """The rows of figures of a run so far; half a line at its end is left out."""
    try:
        text = (run / "metrics.jsonl").read_text()
    except FileNotFoundError:
        return []
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]
