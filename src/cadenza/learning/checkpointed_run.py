"""Training that can be stopped and resumed: the loop, one checkpoint and a log of metrics.

RUN/run.json            what was asked for
RUN/checkpoint/         the learner and the random generator after so many updates
RUN/metrics.jsonl       metrics, a row a line
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from cadenza.files import Expected, checked
from cadenza.learning.checksummed_folder import is_there, read_checksummed, write_checksummed
from cadenza.learning.metrics_log import MetricsLog
from cadenza.resumable import ResumableFolder, errors_of_resuming

Arrays = dict[str, NDArray[Any]]


LOCKED_OUT = "another process is training this run"
"""The error where another process holds the lock of a run."""


@dataclass(frozen=True)
class _Facts:
    """The facts of a checkpoint."""

    update: int
    seconds: float
    rng: dict[str, Any]
    metrics_size: int


class CheckpointedRun(ABC):
    """A run of training by the one process that works in its folder.

    Attributes:
        update: updates so far.
        num_updates: The number of updates of the whole run.
        rows: metrics so far, oldest first.
    """

    command: ClassVar[str]
    """The command that begins and resumes such runs."""
    expected: ClassVar[Expected]
    """The arrays of a checkpoint."""

    @classmethod
    def folder_at(cls, path: Path) -> ResumableFolder:
        """Returns the folder of such a run, which whoever trains it locks before."""
        return ResumableFolder(path, cls.command, LOCKED_OUT)

    def __init__(self, path: Path, num_updates: int, checkpoint_interval: float, seed: int) -> None:
        self.folder, self.num_updates = self.folder_at(path), num_updates
        self.update, self._seconds = 0, 0.0
        self.rows: list[dict[str, Any]] = []
        self._rng = np.random.default_rng(seed)
        self._interval, self._metrics = checkpoint_interval, MetricsLog(path)
        self._checkpoint = path / "checkpoint"
        self._kind = f"checkpoint of {self.command}"

    @abstractmethod
    def _learn(self) -> dict[str, Any] | None:
        """Makes one or more updates and counts them; returns metrics, if it is time for a row."""

    @abstractmethod
    def _arrays(self) -> Arrays:
        """Returns the state of the learner, for `_restore`."""

    @abstractmethod
    def _restore(self, arrays: Arrays) -> None:
        """Goes on from `_arrays`.

        Raises:
            CadenzaError: they are of another learner.
        """

    @abstractmethod
    def _save_result(self) -> None:
        """Writes what has been learnt so far."""

    @property
    def finished(self) -> bool:
        """True when all updates are done."""
        return self.update >= self.num_updates

    @property
    def has_checkpoint(self) -> bool:
        """True if there is one to resume from."""
        return is_there(self._checkpoint)

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Trains until all updates are done, or `goes_on` is false, asked between updates."""
        first, began = self.update, time.perf_counter() - self._seconds
        saved = time.perf_counter()
        while not self.finished and goes_on():
            row = self._learn()
            self._seconds = time.perf_counter() - began
            if row is not None:
                self.rows.append({"step": self.update, "seconds": round(self._seconds, 3)} | row)
                self._metrics.add(self.rows[-1])
            if time.perf_counter() - saved > self._interval:
                self._save()
                saved = time.perf_counter()
        if self.update > first:
            self._save()

    def _save(self) -> None:
        rng = dict(self._rng.bit_generator.state)
        facts = _Facts(self.update, self._seconds, rng, self._metrics.size)
        write_checksummed(self._checkpoint, self._kind, asdict(facts), self._arrays())
        self._save_result()

    def resume(self) -> None:
        """Goes on from the checkpoint, if there is one.

        Raises:
            CadenzaError: it is damaged, or that of another run.
        """
        if not self.has_checkpoint:
            self._metrics.delete()
            return
        with errors_of_resuming(self.folder.path):
            plain, arrays = read_checksummed(self._checkpoint, self._kind, self.expected)
            facts = checked(plain, _Facts, self._checkpoint / "facts.json")
            if not 0 <= facts.update <= self.num_updates:
                raise ValueError(f"after {facts.update} updates")
            self._restore(arrays)
            self.update, self._seconds = facts.update, facts.seconds
            self._rng.bit_generator.state = facts.rng
            self._metrics.truncate(facts.metrics_size)
            self.rows = self._metrics.rows()
            self._save_result()  # a kill may have come before it
