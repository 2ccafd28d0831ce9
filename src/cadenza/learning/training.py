"""Training of a policy for a song or several, which can be stopped and resumed at any moment."""

from __future__ import annotations

import math
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from cadenza.agents.agent import Progress, silent
from cadenza.agents.rollout import play_episodes
from cadenza.errors import CadenzaError, extra_packages
from cadenza.files import checked
from cadenza.learning.checkpointed_run import CheckpointedRun, Count, Row
from cadenza.learning.collector import Collector, Finished
from cadenza.learning.config import TrainingConfig
from cadenza.learning.experience import Chunk, Experience, ReplayExperience
from cadenza.learning.learner import name_of
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.metrics_log import finite
from cadenza.learning.policy import Perceptron
from cadenza.learning.policy_folder import load_policy, save_policy
from cadenza.learning.problem import Problem, problem_of
from cadenza.learning.replay_buffer import ReplayBuffer
from cadenza.learning.run_folder import RunFolder
from cadenza.music.score import Score
from cadenza.resumable import Arrays
from cadenza.tasks.reward import RewardTerm

_EPISODES_AVERAGED = 100  # in a row of metrics
_OF_EPISODES = "f1", "note_onset_f1", "return"  # names of the fields of `Finished` there
_RANDOM_EPISODES = 8  # episodes of a song per evaluation, if the task is randomised


@dataclass(frozen=True)
class _Progress:
    """The values of a checkpoint besides its arrays."""

    best: dict[str, float | None]  # the row of the best evaluation
    collector: dict[str, Any]
    finished: tuple[tuple[float | None, float | None, float | None], ...]
    replay: tuple[Chunk, ...]
    # Pairs of a step, and the last step of the run as set then
    ends: tuple[tuple[Count, Count], ...]
    threads: int | None  # threads of the learner, if their number is known
    updates: Count  # updates of the learner so far


def begin(
    config: TrainingConfig,
    scores: Sequence[Score],
    folder: RunFolder,
    progress: Progress = silent,
    reward_terms: Mapping[str, RewardTerm] | None = None,
) -> Training:
    """Begin a run in a folder, with progress and reward terms as of `problem_of`.

    Raises CadenzaError as `problem_of`, or if the folder holds a run already; no run is begun then.
    """
    folder.begin(config, scores, tuple(reward_terms or ()))
    try:
        return Training(problem_of(config, scores, progress, None, reward_terms), folder)
    except CadenzaError:
        folder.manifest.unlink()
        raise


class Training(CheckpointedRun):
    """A run of training; its steps are control steps of all environments together.

    Attributes:
        best: The evaluation with the most right notes so far, empty before the first.
    """

    command: ClassVar[str] = "cadenza train"

    def __init__(self, problem: Problem, folder: RunFolder) -> None:
        """Resume from the checkpoint in `folder`, if there is one.

        Raises CadenzaError if the checkpoint is damaged, a library that the learner needs is
        missing, or there is no room for its experience.
        """
        config = problem.config
        rng, sample_rng = np.random.default_rng(config.seed).spawn(2)
        super().__init__(folder, config.num_steps, config.checkpoint_interval, sample_rng)
        self.config, self.best = config, Row()
        self._problem, self._updates = problem, 0
        self._experience = _experience(problem, folder, rng, sample_rng)
        self._background = ThreadPoolExecutor(1)
        self._evaluation: Future[tuple[Row, LearntPolicy]] | None = None
        self._metrics: list[dict[str, NDArray[Any]]] = []
        self._finished = deque[Finished](maxlen=_EPISODES_AVERAGED)
        with threadpool_limits(1):
            self.resume()

    def _make_learner(self, *ends: tuple[int, int]) -> None:
        """Make the learner of a run with these ends, see `_Progress`."""
        config, problem, self._ends = self.config, self._problem, ends
        updates = tuple((config.updates_by(since), config.updates_by(end)) for since, end in ends)
        actions = problem.task.spec.action_size
        self._learner = config.learner.make(problem.inputs, actions, updates)

    def _begin(self) -> None:
        self._make_learner((0, self.num_steps))
        self._state = self._learner.init(self.config.seed)
        self._experience.begin()
        if self.config.residual:
            self._evaluate()  # the uncorrected reference: only better policies are kept

    # The loop

    def run(self, goes_on: Callable[[], bool]) -> None:
        """Train until all steps are done or `goes_on` is false, which is asked once a round.

        Raises CadenzaError if there is no room for a checkpoint, or the policy is no longer finite.
        """
        with threadpool_limits(1):  # the other cores learn
            super().run(goes_on)

    def _learn(self) -> Row | None:
        before = self.step
        self._round()
        if self.finished or self._passed(before, self.config.eval_interval):
            self._evaluate()
        return self._row() if self._passed(before, self.config.log_interval) else None

    def _passed(self, before: int, interval: int) -> bool:
        return before // interval != self.step // interval

    def _round(self) -> None:
        """Collect experience, and learn; raises CadenzaError if the policy is not finite."""
        config = self.config
        self._state, metrics, finished = self._experience.round(
            self._learner, self._state, self.step
        )
        self._finished += finished
        self.step += config.train_freq * config.num_envs
        if not metrics:
            return
        self._metrics.append({name: np.asarray(values) for name, values in metrics.items()})
        self._updates += config.gradient_steps
        _, arrays = self._learner.behavior_policy(self._state).state()
        if not all(np.isfinite(array).all() for array in arrays.values()):
            raise CadenzaError(
                f"{self.folder.path}: the policy is no longer finite; start a new run with "
                "smaller learning rates"
            )

    def learnt(self) -> LearntPolicy:
        """The policy learnt so far."""
        problem, policy = self._problem, self._learner.policy(self._state)
        return LearntPolicy(
            policy=policy,
            observation=problem.observation,
            inputs=problem.inputs,
            reference=problem.reference,
            ranges=problem.ranges,
            task=self.config.task,
            scene=problem.scene,
            score=problem.scores[0] if len(problem.scores) == 1 else None,
            learner=None if type(policy) is Perceptron else name_of(self.config.learner),
        )

    # Figures

    def _row(self) -> Row:
        metrics = _concatenated(self._metrics)
        self._metrics.clear()
        row = {
            f"train/{name}": float(np.nanmean(values))
            for name, values in metrics.items()
            if not np.isnan(values).all()  # no update has had one
        }
        for name, values in zip(_OF_EPISODES, zip(*self._finished, strict=True), strict=False):
            if not np.isnan(values).all():
                row[f"episodes/{name}"] = float(np.mean(values))
        return row | {"updates": self._updates}

    def _evaluate(self) -> None:
        self._finish_evaluation()
        self._evaluation = self._background.submit(self._play_episode, self.learnt(), self.step)

    def _play_episode(self, learnt: LearntPolicy, step: int) -> tuple[Row, LearntPolicy]:
        """Play every song; its row has the means over the episodes."""
        values = defaultdict[str, list[float]](list)
        count = _RANDOM_EPISODES if self.config.task.randomization.is_on else 1
        seeds = range(self.config.seed, self.config.seed + count)
        for score in self._problem.scores:
            with closing(self._problem.evaluation_task(score, count)) as task:
                played = play_episodes(task, learnt.agent, seeds)
            for name, value in (item for each in played for item in each.metrics.items()):
                if isinstance(value, int | float) and not math.isnan(value):
                    values[name].append(float(value))
        row = {f"eval/{name}": float(np.mean(of_songs)) for name, of_songs in values.items()}
        return {"eval_step": step} | row, learnt

    def _finish_evaluation(self) -> None:
        """Wait for the running evaluation and save its policy if it is the best so far."""
        if self._evaluation is None:
            return
        row, learnt = self._evaluation.result()
        self._evaluation = None
        self._add_row(row)
        if not self.best or _rank(row) > _rank(self.best):
            self.best = row
            self._save_policy("best", learnt, row)

    def _settle(self) -> None:
        if self.finished and not (self.best or self._evaluation):
            self._evaluate()  # a run that is over has a best policy
        self._finish_evaluation()

    # Checkpoints

    def _arrays(self) -> Arrays:
        parts = {"learner": self._learner.to_arrays(self._state)}
        parts |= {"collector": self._experience.state()[1], "scores": self._problem.goals.arrays()}
        parts |= {"metrics": _concatenated(self._metrics)}
        return {f"{part}:{name}": a for part, arrays in parts.items() for name, a in arrays.items()}

    def _facts(self) -> dict[str, Any]:
        progress = _Progress(
            best={name: finite(value) for name, value in self.best.items()},
            collector=self._experience.state()[0],
            finished=tuple(
                (finite(f1), finite(onsets), finite(total)) for f1, onsets, total in self._finished
            ),
            replay=self._experience.save(self.step),
            ends=self._ends,
            threads=self._learner.num_threads,
            updates=self._updates,
        )
        return asdict(progress)

    def _save_result(self) -> None:
        self._experience.drop_unneeded()
        self._save_policy("last", self.learnt(), {"step": self.step})

    def _save_policy(self, name: str, learnt: LearntPolicy, about: Row) -> None:
        fingers = self._problem.task.tracks[0].rewarded_fingers
        save_policy(self.folder.path / name, learnt, about | {"rewarded_fingers": fingers})

    def _restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        progress = checked(facts, _Progress, self.folder.checkpoint)
        ends = progress.ends
        if ends[-1][1] != self.num_steps:
            ends = (*ends, (self.step, self.num_steps))
        self._make_learner(*ends)
        parts = defaultdict[str, Arrays](dict)
        for path, array in arrays.items():
            part, _, name = path.partition(":")
            parts[part][name] = array
        if progress.best and self._best_is_there():
            self.best = {name: _or_nan(value) for name, value in progress.best.items()}
        self._finished += [Finished(*map(_or_nan, episode)) for episode in progress.finished]
        self._updates = progress.updates
        self._state = self._learner.from_arrays(parts["learner"])
        self._problem.goals.restore(parts["scores"])
        self._metrics = [parts["metrics"]] if "metrics" in parts else []
        self._experience.restore(progress.collector, parts["collector"], progress.replay)

    def _best_is_there(self) -> bool:
        """Whether the best policy can be read; else the next evaluation replaces it."""
        try:
            load_policy(self.folder.path / "best")
        except CadenzaError as error:
            print(error, file=sys.stderr)
            return False
        return True

    def close(self) -> None:
        """Stop the threads."""
        self._background.shutdown()
        self._problem.task.close()


def _experience(
    problem: Problem, folder: RunFolder, rng: np.random.Generator, sample_rng: np.random.Generator
) -> Experience:
    """The source of experience that a learner needs.

    Environments and actions draw from `rng`, samples to learn from are drawn from `sample_rng`.
    """
    config, task, goals = problem.config, problem.task, problem.goals
    observer, mapping = problem.observer, problem.mapping
    if not config.learner.on_policy:
        actions = task.spec.action_size
        replay = ReplayBuffer(observer, config.num_envs, config.buffer_size, actions)
        collector = Collector(task, goals, observer, replay, mapping, rng)
        return ReplayExperience(config, collector, replay, goals, sample_rng, folder.replay)
    with extra_packages("train", "training"):
        from cadenza.learning.algorithms.on_jax import start_jax
        from cadenza.learning.on_policy import HostRollouts
    start_jax()  # before the device's task does, with as many threads as there are
    if config.scene.engine == "c":
        collector = Collector(task, goals, observer, None, mapping, rng)
        return HostRollouts(config, collector, sample_rng)
    with extra_packages("gpu", "the engine warp"):
        from cadenza.learning.device_rollouts import DeviceRollouts
        from cadenza.tasks.functional import FunctionalPianoTask
    songs, terms = list(problem.scores), problem.reward_terms
    own = FunctionalPianoTask(songs, config.task, task.scene, config.num_envs, reward_terms=terms)
    return DeviceRollouts(config, own, problem.inputs, problem.ranges, rng, sample_rng)


def _rank(row: Row) -> tuple[float, ...]:
    """The rank of an evaluation: note onset F1, F1 (each times its length), then loudness."""
    names = "eval/note_onset_f1", "eval/f1"
    loudness = -row.get("eval/velocity_error", math.inf)
    return *(float(row[name] * row["eval/steps"]) for name in names), loudness


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def _concatenated(metrics: list[dict[str, NDArray[Any]]]) -> dict[str, NDArray[Any]]:
    """Metrics (U,) of all updates by name, from the metrics (u,) of each round."""
    names = metrics[0] if metrics else {}
    return {name: np.concatenate([each[name] for each in metrics]) for name in names}
