"""The protocol of sources of experience, and the source with a replay buffer."""

import re
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Annotated, Any, Protocol

import numpy as np
from msgspec import Meta

from cadenza.errors import CadenzaError
from cadenza.files import ANY, read_arrays, remove_half_written, write_atomically
from cadenza.learning.checkpointed_run import Count
from cadenza.learning.collector import Collector, Finished
from cadenza.learning.config import TrainingConfig
from cadenza.learning.learner import Learner
from cadenza.learning.observation import GoalTable
from cadenza.learning.replay_buffer import Batch, ReplayBuffer
from cadenza.resumable import Arrays

_CHUNK = r"\d{12,}\.\d+\.npz"  # names of files of experience; others are left alone
_MAX_HEADERS = 2**12  # bytes, of the arrays of experience

Round = tuple[Any, dict[str, Any], list[Finished]]
"""The learner's state after a round, metrics (U,) of its updates by name, and the episodes that
ended. The metrics are empty if there was no update."""


@dataclass(frozen=True)
class Chunk:
    """A file of experience for the replay buffer."""

    file: Annotated[str, Meta(pattern=f"^{_CHUNK}$")]
    to: tuple[Count, ...]  # the number of frames of each environment up to the end of the chunk


class Experience(Protocol):
    """N environments whose experience a learner improves its policy by, in rounds."""

    def begin(self) -> None:
        """Begin an episode in every environment."""

    def round(self, learner: Any, state: Any, step: int) -> Round:
        """Take `train_freq` control steps in every environment, and make updates.

        The learner's policy of `state` collects; `step` counts the control steps so far of all
        environments together.
        """

    def save(self, step: int) -> tuple[Chunk, ...]:
        """Write experience that is in no file yet; returns the files that `restore` needs."""

    def drop_unneeded(self) -> None:
        """Delete files that the latest checkpoint does not need."""

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """The state of the environments as JSON and arrays, for `restore`."""

    def restore(self, plain: dict[str, Any], arrays: Arrays, chunks: Sequence[Chunk]) -> None:
        """Go on from `state` and from the files of `save`.

        Raises CadenzaError if they are of another run, or a file is missing or damaged.
        """


class ReplayExperience:
    """`Experience` of the policies of all rounds, kept in a replay buffer."""

    def __init__(
        self,
        config: TrainingConfig,
        collector: Collector,
        replay: ReplayBuffer,
        goals: GoalTable,
        sample_rng: np.random.Generator,
        folder: Path,
    ) -> None:
        """Begin with an empty buffer, which the collector fills and `sample_rng` samples.

        Files of experience lie in the folder.
        """
        self._config, self._collector, self._replay = config, collector, replay
        self._goals, self._sample_rng = goals, sample_rng
        self.begin, self.state = collector.begin, collector.state
        self._folder, self._chunks = folder, list[Chunk]()

    def round(self, learner: Learner[Any], state: Any, step: int) -> Round:
        collect, steps = self._collector.collect, self._config.train_freq
        if step < self._config.learning_starts:
            return state, {}, collect(None, steps)
        policy = learner.behavior_policy(state)
        if not len(self._replay):
            return state, {}, collect(policy, steps)
        if not self._config.parallel:
            finished = collect(policy, steps)
            return *learner.update(state, self._batches()), finished
        with ThreadPoolExecutor(1) as thread:
            learning = thread.submit(learner.update, state, self._batches())
            finished = collect(policy, steps)
        return *learning.result(), finished

    def _batches(self) -> Batch:
        shape = self._config.gradient_steps, self._config.learner.batch_size
        return self._replay.sample(self._sample_rng, shape)

    def save(self, step: int) -> tuple[Chunk, ...]:
        since = np.array(self._chunks[-1].to) if self._chunks else 0
        frames = self._replay.since(since)
        # The file of a checkpoint at the same step is still needed.
        paths = (self._folder / f"{step:012}.{number}.npz" for number in count())
        path = next(path for path in paths if not path.exists())
        with write_atomically(path) as file:
            np.savez(file, allow_pickle=False, **frames)
        chunk = Chunk(path.name, tuple(frames["to"].tolist()))
        self._chunks = [c for c in self._chunks if self._replay.holds(np.array(c.to))] + [chunk]
        return tuple(self._chunks)

    def drop_unneeded(self) -> None:
        remove_half_written(self._folder)
        needed = {chunk.file for chunk in self._chunks}
        for path in self._folder.glob("*.npz"):
            if path.name not in needed and re.fullmatch(_CHUNK, path.name, re.ASCII):
                path.unlink()

    def restore(self, plain: dict[str, Any], arrays: Arrays, chunks: Sequence[Chunk]) -> None:
        max_bytes = self._replay.num_bytes + _MAX_HEADERS
        for chunk in chunks:
            frames = read_arrays(self._folder / chunk.file, ANY, max_bytes)
            rows = frames["row"]
            if len(rows) and not 0 <= rows.min() <= rows.max() < self._goals.num_rows:
                raise CadenzaError(f"{chunk.file}: experience of other scores; start a new run")
            self._replay.restore(frames)
        self._chunks = list(chunks)
        self._collector.restore(plain, arrays)
