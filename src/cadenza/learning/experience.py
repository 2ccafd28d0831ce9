"""Sources of experience: what a run asks of one, and the one that keeps all in a replay buffer."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import numpy as np

from cadenza.errors import CadenzaError
from cadenza.learning.collector import Collector, Finished
from cadenza.learning.config import TrainingConfig
from cadenza.learning.learner import Learner
from cadenza.learning.observation import GoalTable
from cadenza.learning.policy import Policy
from cadenza.learning.replay_buffer import Batch, ReplayBuffer
from cadenza.learning.run_folder import Arrays, Chunk, RunFolder

Round = tuple[Any, dict[str, Any], list[Finished]]
"""The learner's state after a round; metrics (U,) by name of each update, empty if there was none;
and the episodes that ended."""
Saved = Sequence[tuple[Chunk, Arrays | None]]
"""Files of experience, and what is in them; None where it is lost."""


class Experience(Protocol):
    """N environments that give experience, by which a learner improves its policy in rounds."""

    @property
    def most_bytes(self) -> int | None:
        """The bytes that one file of experience may take; None if none is written."""

    def begin(self) -> None:
        """Begins an episode in every environment."""

    def round(self, learner: Any, state: Any, policy: Policy, step: int) -> Round:
        """Takes `train_freq` control steps in every environment, and makes updates.

        Args:
            learner: the learner.
            state: its state.
            policy: its policy, which collects experience.
            step: control steps so far, of all environments together.
        """

    def save(self, folder: RunFolder, step: int) -> tuple[Chunk, ...]:
        """Writes experience that is in no file yet; returns which files `restore` needs."""

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """Returns the state of the environments as JSON and arrays, for `restore`."""

    def restore(self, plain: dict[str, Any], arrays: Arrays, saved: Saved) -> None:
        """Goes on from `state` and from experience that was `saved`.

        Raises:
            CadenzaError: they are of another run.
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
    ) -> None:
        """Begins with an empty buffer.

        Args:
            config: the options of the run.
            collector: the collector, which fills the buffer.
            replay: the buffer.
            goals: the goals of all scores that it knows.
            sample_rng: the source of randomness of what is sampled.
        """
        self._config, self._collector, self._replay = config, collector, replay
        self._goals, self._sample_rng = goals, sample_rng
        self.begin, self.state = collector.begin, collector.state
        self.most_bytes = replay.num_bytes
        self._chunks: list[Chunk] = []

    def round(self, learner: Learner[Any], state: Any, policy: Policy, step: int) -> Round:
        collect, steps = self._collector.collect, self._config.train_freq
        if (random := step < self._config.learning_starts) or not len(self._replay):
            return state, {}, collect(None if random else policy, steps)
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

    def save(self, folder: RunFolder, step: int) -> tuple[Chunk, ...]:
        since = np.array(self._chunks[-1].to) if self._chunks else 0
        frames = self._replay.since(since)
        chunk = Chunk(folder.save_experience(step, frames), tuple(frames["to"].tolist()))
        self._chunks = [c for c in self._chunks if self._replay.holds(np.array(c.to))] + [chunk]
        return tuple(self._chunks)

    def restore(self, plain: dict[str, Any], arrays: Arrays, saved: Saved) -> None:
        for chunk, frames in saved:
            if frames is None:
                continue
            rows = frames["row"]
            if len(rows) and not 0 <= rows.min() <= rows.max() < self._goals.num_rows:
                raise CadenzaError(f"{chunk.file}: experience of other scores; start a new run")
            self._replay.restore(frames)
            self._chunks.append(chunk)
        if saved:
            self._replay.skip(np.array(saved[-1][0].to))
        self._collector.restore(plain, arrays)
