"""Trains a policy for a song or for several, to be stopped and resumed at any moment."""

from __future__ import annotations

import math
import sys
import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from cadenza.agents.rollout import play_episode
from cadenza.errors import CadenzaError, extra_packages
from cadenza.files import FLOATS, NUMBERS, ArrayOf
from cadenza.learning.actions import ActionMapping, reference_of
from cadenza.learning.collector import Collector, Finished
from cadenza.learning.config import TrainingConfig, check
from cadenza.learning.experience import Experience, ReplayExperience
from cadenza.learning.learner import name_of
from cadenza.learning.metrics_log import finite
from cadenza.learning.observation import GoalTable, Inputs, ObservationSpec, Observer, pruned
from cadenza.learning.policy import Perceptron
from cadenza.learning.policy_folder import LearntPolicy, load_policy, save_policy
from cadenza.learning.ranges import ranges_of
from cadenza.learning.replay_buffer import ReplayBuffer
from cadenza.learning.run_folder import Checkpoint, Facts, RunFolder
from cadenza.music.score import Score
from cadenza.resumable import errors_of_resuming
from cadenza.sim.threads import available_cores
from cadenza.tasks.augmentation import draws_pitch
from cadenza.tasks.piano_task import PianoTask

Row = dict[str, float]

_EPISODES_AVERAGED = 100  # in a row of metrics
_EXPECTED = {  # arrays of a checkpoint; whoever restores them checks their sizes
    "learner:*": ArrayOf(NUMBERS, None),
    "collector:*": ArrayOf(NUMBERS, None),
    "scores:*": ArrayOf(NUMBERS, None),
    "metrics:*": ArrayOf(FLOATS, ("updates",)),
}


def begin(config: TrainingConfig, scores: Sequence[Score], folder: RunFolder) -> Training:
    """Begins a run in a folder, which holds none if it cannot be made.

    Raises:
        CadenzaError: see `Training`, or the folder holds a run already.
    """
    folder.begin(config, scores)
    try:
        return Training(config, scores, folder)
    except CadenzaError:
        folder.forget()
        raise


class Training:
    """A run of training.

    Attributes:
        step: control steps so far, of all environments together.
        best: the evaluation with the most right steps so far, empty before the first.
        rows: metrics since the last look, oldest first; whoever shows them takes them out.
    """

    def __init__(self, config: TrainingConfig, scores: Sequence[Score], folder: RunFolder) -> None:
        """Resumes from the newest checkpoint in `folder`, if there is one.

        Args:
            config: The options of the run.
            scores: the songs to learn, of which each episode draws one.
            folder: The folder of the run.

        Raises:
            CadenzaError: a song cannot be played, an option makes no sense, or the checkpoints
                are damaged.
        """
        check(config)
        self.config, self._folder = config, folder
        self.step, self.best, self.rows = 0, Row(), deque[Row]()
        self._updates = 0
        # What is learnt on a GPU is evaluated in C, and plays there.
        self._scene = replace(config.scene, engine="c")
        self._scores = [s.without_fingers() for s in scores] if config.residual else list(scores)
        on_policy, on_device = config.learner.on_policy, config.scene.engine == "warp"
        num_envs = 1 if on_device else config.num_envs  # those on a device have a task of their own
        self._task = self._task_of(self._scores, num_envs, available_cores() if on_policy else 1)
        self._rewarded = {"rewarded_fingers": self._task.tracks[0].rewarded_fingers}
        self._goals = GoalTable(self._task.spec)
        self._goals.add_all(self._task)
        self._reference = reference_of(self._task) if config.residual else None
        narrowed = config.song_range and self._task.scene.sides
        self._ranges = ranges_of(self._task) if narrowed else None
        mapping = ActionMapping(self._task.spec, self._reference, self._ranges)
        self._observation = ObservationSpec.of(self._task.spec, config.residual)
        prune = config.prune_inputs and not draws_pitch(config.task)  # asks for the same keys
        inputs = pruned(self._observation, self._goals) if prune else self._observation.inputs
        if on_policy:  # rollouts need not tell what an action led to: the state does
            layout = self._observation.layout
            previous = range(layout["previous_action"].start, layout["previous_reward"].stop)
            kept = tuple(i for i in inputs.kept if i not in previous)
            inputs = Inputs(kept, inputs.total)
        self._inputs = inputs
        rng, self._sample_rng = np.random.default_rng(config.seed).spawn(2)
        observer = Observer(
            self._task.spec, self._goals, self._inputs, mapping.reference, self._ranges
        )
        self._experience = self._make_experience(observer, mapping, rng)
        checkpoint = folder.load(_EXPECTED, self._experience.most_bytes)
        self._ends = _ends(config, checkpoint)
        ends = tuple(
            (config.updates_by(since), config.updates_by(end)) for since, end in self._ends
        )
        self._learner = config.learner.make(self._inputs, self._task.spec.action_size, ends)
        self._state = self._learner.init(config.seed)
        self._policy = self._learner.behavior_policy(self._state)
        self._background = ThreadPoolExecutor(1)
        self._evaluation: Future[tuple[Row, LearntPolicy]] | None = None
        self._metrics: list[dict[str, NDArray[Any]]] = []
        self._finished = deque[Finished](maxlen=_EPISODES_AVERAGED)
        self._seconds = 0.0
        with threadpool_limits(1):
            if checkpoint is None:
                self._experience.begin()
                return
            with errors_of_resuming(folder.path):
                self._restore(checkpoint)

    def _task_of(
        self, scores: Sequence[Score], num_envs: int = 1, num_threads: int = 1
    ) -> PianoTask:
        return PianoTask(scores, self.config.task, self._scene, num_envs, num_threads)

    def _make_experience(
        self, observer: Observer, mapping: ActionMapping, rng: np.random.Generator
    ) -> Experience:
        config, task, goals = self.config, self._task, self._goals
        if not config.learner.on_policy:
            actions = task.spec.action_size
            replay = ReplayBuffer(observer, config.num_envs, config.buffer_size, actions)
            collector = Collector(task, goals, observer, replay, mapping, rng)
            return ReplayExperience(config, collector, replay, goals, self._sample_rng)
        with extra_packages("train", "training"):
            from cadenza.learning.algorithms.on_jax import start_jax
            from cadenza.learning.on_policy import HostRollouts
        start_jax()  # before the device's task does, with as many threads as there are
        if config.scene.engine == "c":
            collector = Collector(task, goals, observer, None, mapping, rng)
            return HostRollouts(config, collector, self._sample_rng)
        with extra_packages("gpu", "the engine warp"):
            from cadenza.learning.device_rollouts import DeviceRollouts
            from cadenza.tasks.functional import FunctionalPianoTask
        own = FunctionalPianoTask(self._scores, config.task, task.scene, config.num_envs)
        return DeviceRollouts(config, own, self._inputs, self._ranges, rng, self._sample_rng)

    # The loop

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Trains until all steps are done or `goes_on` is false, which is asked once a round.

        Raises:
            CadenzaError: there is no room for a checkpoint.
        """
        saved_step, began = self.step, time.perf_counter() - self._seconds
        saved = time.perf_counter()
        with threadpool_limits(1):  # the other cores learn
            while self.step < self.config.num_steps and goes_on():
                before = self.step
                self._round()
                self._seconds = time.perf_counter() - began
                finished = self.step >= self.config.num_steps
                if finished or self._passed(before, self.config.eval_interval):
                    self._evaluate()
                if self._passed(before, self.config.log_interval):
                    self._log()
                if time.perf_counter() - saved > self.config.checkpoint_interval:
                    self._save()
                    saved_step, saved = self.step, time.perf_counter()
            if self.step >= self.config.num_steps and not (self.best or self._evaluation):
                self._evaluate()  # a run that is over has a best policy
            self._finish_evaluation()
            if self.step > saved_step:
                self._save()

    def _passed(self, before: int, interval: int) -> bool:
        return before // interval != self.step // interval

    def _round(self) -> None:
        """Collects experience, and learns from it.

        Raises:
            CadenzaError: the policy is no longer finite.
        """
        config = self.config
        self._state, metrics, finished = self._experience.round(
            self._learner, self._state, self._policy, self.step
        )
        self._finished += finished
        self.step += config.train_freq * config.num_envs
        if not metrics:
            return
        self._metrics.append({name: np.asarray(values) for name, values in metrics.items()})
        self._updates += config.gradient_steps
        self._policy = self._learner.behavior_policy(self._state)
        _, arrays = self._policy.state()
        if not all(np.isfinite(array).all() for array in arrays.values()):
            raise CadenzaError(
                f"{self._folder.path}: the policy is no longer finite; start a new run with "
                "smaller learning rates"
            )

    def learnt(self) -> LearntPolicy:
        """Returns the policy learnt so far."""
        config, policy = self.config, self._learner.policy(self._state)
        return LearntPolicy(
            policy=policy,
            observation=self._observation,
            inputs=self._inputs,
            reference=self._reference,
            ranges=self._ranges,
            task=config.task,
            scene=self._scene,
            score=self._scores[0] if len(self._scores) == 1 else None,
            learner=None if type(policy) is Perceptron else name_of(config.learner),
        )

    # Figures

    def _log(self) -> None:
        metrics = _concatenated(self._metrics)
        row = {
            f"train/{name}": float(np.nanmean(values))
            for name, values in metrics.items()
            if not np.isnan(values).all()  # no update has had one
        }
        if self._finished:
            row["episodes/f1"] = float(np.mean([episode.f1 for episode in self._finished]))
            row["episodes/return"] = float(
                np.mean([episode.total_reward for episode in self._finished])
            )
        self._metrics.clear()
        self._add_row(row | {"updates": self._updates})

    def _add_row(self, row: Row) -> None:
        row = {"step": self.step, "seconds": round(self._seconds, 3)} | row
        self._folder.add_row(row)
        self.rows.append(row)

    def _evaluate(self) -> None:
        self._finish_evaluation()
        self._evaluation = self._background.submit(self._play_episode, self.learnt(), self.step)

    def _play_episode(self, learnt: LearntPolicy, step: int) -> tuple[Row, LearntPolicy]:
        """Plays every song once; its row has the means over them."""
        values = defaultdict[str, list[float]](list)
        for score in self._scores:
            with closing(self._task_of([score])) as task:
                metrics = play_episode(task, learnt.agent, self.config.seed).metrics
            for name, value in metrics.items():
                if isinstance(value, int | float) and not math.isnan(value):  # which has a value
                    values[name].append(float(value))
        row = {f"eval/{name}": float(np.mean(of_songs)) for name, of_songs in values.items()}
        return {"eval_step": step} | row, learnt

    def _finish_evaluation(self) -> None:
        """Waits for the running evaluation and saves its policy if it is the best so far."""
        if self._evaluation is None:
            return
        row, learnt = self._evaluation.result()
        self._evaluation = None
        self._add_row(row)
        if not self.best or _f1_steps(row) > _f1_steps(self.best):
            self.best = row
            save_policy(self._folder.path / "best", learnt, row | self._rewarded)

    # Checkpoints

    def _save(self) -> None:
        self._finish_evaluation()
        replay = self._experience.save(self._folder, self.step)
        plain, arrays = self._experience.state()
        facts = Facts(
            step=self.step,
            seconds=self._seconds,
            best={name: finite(value) for name, value in self.best.items()},
            sample_rng=dict(self._sample_rng.bit_generator.state),
            collector=plain,
            finished=tuple((finite(f1), finite(total)) for f1, total in self._finished),
            replay=replay,
            ends=self._ends,
            threads=self._learner.num_threads,
            updates=self._updates,
        )
        parts = {"learner": self._learner.to_arrays(self._state), "collector": arrays}
        parts |= {"scores": self._goals.arrays(), "metrics": _concatenated(self._metrics)}
        self._folder.save(facts, _with_prefixes(parts))
        self._save_last()

    def _save_last(self) -> None:
        save_policy(self._folder.path / "last", self.learnt(), {"step": self.step} | self._rewarded)

    def _restore(self, checkpoint: Checkpoint) -> None:
        facts, parts = checkpoint.facts, _by_prefix(checkpoint.arrays)
        self.step, self._seconds = facts.step, facts.seconds
        if facts.best and self._best_is_there():
            self.best = {name: _or_nan(value) for name, value in facts.best.items()}
        self._finished += [Finished(*map(_or_nan, episode)) for episode in facts.finished]
        self._sample_rng.bit_generator.state = facts.sample_rng
        self._updates = facts.updates
        self._state = self._learner.from_arrays(parts["learner"])
        self._policy = self._learner.behavior_policy(self._state)
        self._goals.restore(parts["scores"])
        self._metrics = [parts["metrics"]] if "metrics" in parts else []
        saved = list(zip(facts.replay, checkpoint.replay, strict=True))
        self._experience.restore(facts.collector, parts["collector"], saved)
        self._save_last()  # a kill may have come before it

    def _best_is_there(self) -> bool:
        """Returns whether the best policy can be read; else the next evaluation replaces it."""
        try:
            load_policy(self._folder.path / "best")
        except CadenzaError as error:
            print(error, file=sys.stderr)
            return False
        return True

    def close(self) -> None:
        """Stops the threads."""
        self._background.shutdown()
        self._task.close()


def _ends(config: TrainingConfig, checkpoint: Checkpoint | None) -> tuple[tuple[int, int], ...]:
    """Returns since which step the run was to end at which one, its present end last."""
    ends = checkpoint.facts.ends if checkpoint else ()
    if not ends:
        return ((0, config.num_steps),)
    if checkpoint and ends[-1][1] != config.num_steps:
        return (*ends, (checkpoint.facts.step, config.num_steps))
    return ends


def _f1_steps(row: Row) -> float:
    """Returns F1 times the length of an evaluation, which a wrong key may end early."""
    return row["eval/f1"] * row["eval/steps"]


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _concatenated(metrics: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Returns metrics (U,) by name of all updates, from those (u,) of each round."""
    names = metrics[0] if metrics else {}
    return {name: np.concatenate([some[name] for some in metrics]) for name in names}


def _with_prefixes(parts: dict[str, dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    return {f"{part}:{name}": a for part, arrays in parts.items() for name, a in arrays.items()}


def _by_prefix(arrays: dict[str, NDArray[Any]]) -> dict[str, dict[str, NDArray[Any]]]:
    parts: dict[str, dict[str, NDArray[Any]]] = {}
    for name, array in arrays.items():
        part, _, rest = name.partition(":")
        parts.setdefault(part, {})[rest] = array
    return parts
