"""Training that can be stopped and resumed: the loop and its checkpoint.

RUN/run.json and RUN/checkpoint.safetensors are those of `cadenza.resumable`, RUN/metrics.jsonl that
of `metrics_log`.
"""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from msgspec import Meta

from cadenza.learning.metrics_log import MetricsLog
from cadenza.resumable import Arrays, ResumableFolder

Count = Annotated[int, Meta(ge=0, le=2**53)]
Row = dict[str, Any]

LOCKED_OUT = "another process is training this run"
"""The error where another process holds the lock of a run."""


@dataclass(frozen=True)
class _Facts:
    step: Count
    seconds: float
    rng: dict[str, Any]
    metrics_size: Count
    own: dict[str, Any]  # the values that this kind of run keeps beside those of every run


class CheckpointedRun(ABC):
    """A run of training by the one process that works in its folder.

    Attributes:
        folder: The folder of the run, which the caller must have locked.
        step: Steps so far: updates, or what else a kind of run counts.
        num_steps: The number of steps of the whole run.
        rows: Metrics so far, oldest first.
    """

    command: ClassVar[str]  # the command that begins and resumes such runs

    @classmethod
    def folder_at(cls, path: Path) -> ResumableFolder:
        """The folder of such a run; the caller must lock it before making the run."""
        return ResumableFolder(path, cls.command, LOCKED_OUT)

    def __init__(
        self,
        folder: ResumableFolder,
        num_steps: int,
        checkpoint_interval: float,
        rng: np.random.Generator,
    ) -> None:
        """Neither begins nor resumes the run of `num_steps` in a folder; see `resume`.

        Checkpoints, which have the state of `rng`, come every `checkpoint_interval` [s].
        """
        self.folder, self.num_steps = folder, num_steps
        self.step, self._seconds = 0, 0.0
        self.rows: list[Row] = []
        self._rng, self._interval = rng, checkpoint_interval
        self._metrics_log = MetricsLog(folder.path)

    def _begin(self) -> None:  # noqa: B027 - most have nothing to do
        """Begin a run without a checkpoint."""

    @abstractmethod
    def _learn(self) -> Row | None:
        """Make one or more steps and count them; return metrics, if it is time for a row."""

    @abstractmethod
    def _arrays(self) -> Arrays:
        """The state of the learner, for `_restore`."""

    def _facts(self) -> dict[str, Any]:
        """What `_restore` needs besides arrays."""
        return {}

    @abstractmethod
    def _restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        """Go on from `_facts` and `_arrays`; raises CadenzaError if they are of another learner."""

    @abstractmethod
    def _save_result(self) -> None:
        """Write what has been learnt so far."""

    def _settle(self) -> None:  # noqa: B027 - most have nothing to do
        """Finish what goes on in the background, before a checkpoint."""

    @property
    def finished(self) -> bool:
        """True when all steps are done."""
        return self.step >= self.num_steps

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Train until all steps are done, or `goes_on` is false, asked after every few of them.

        Raises CadenzaError if there is no room for a checkpoint.
        """
        self._began = time.perf_counter() - self._seconds
        saved_step, saved = self.step, time.perf_counter()
        while not self.finished and goes_on():
            row = self._learn()
            if row is not None:
                self._add_row(row)
            if time.perf_counter() - saved > self._interval:
                self._save()
                saved_step, saved = self.step, time.perf_counter()
        self._settle()
        if self.step > saved_step:
            self._save()

    def _add_row(self, row: Row) -> None:
        self._seconds = time.perf_counter() - self._began
        row = {"step": self.step, "seconds": round(self._seconds, 3)} | row
        with self.folder.errors_of_writing():
            self._metrics_log.add(row)
        self.rows.append(row)

    def _save(self) -> None:
        self._settle()
        self._seconds = time.perf_counter() - self._began
        with self.folder.errors_of_writing():
            rng, size = dict(self._rng.bit_generator.state), self._metrics_log.size
            facts = _Facts(self.step, self._seconds, rng, size, self._facts())
            self.folder.save(asdict(facts), self._arrays())
            self._save_result()

    def resume(self) -> None:
        """Go on from the checkpoint, or begin; raises CadenzaError if it is no use."""
        if (latest := self.folder.load(_Facts)) is None:
            self._metrics_log.delete()
            self._begin()
            return
        facts, arrays = latest
        with self.folder.errors_of_resuming():
            self.step, self._seconds = facts.step, facts.seconds
            self._restore(facts.own, arrays)
            self._rng.bit_generator.state = facts.rng
        with self.folder.errors_of_writing():
            self._metrics_log.truncate(facts.metrics_size)
            self.rows = self._metrics_log.rows()
            self._save_result()  # a kill may have come before it
