"""Training of a policy for many songs on demonstrations.

RUN/run.json also names the episodes that are learnt from, and RUN/last/ is the policy of the
checkpoint. The other files are those of `checkpointed_run`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.demonstrations.dataset import Dataset, StepBatch, check_values, dataset_folder, kept
from cadenza.demonstrations.recorded_episode import RecordedEpisode
from cadenza.errors import CadenzaError, extra_packages
from cadenza.files import checked
from cadenza.learning.checkpointed_run import CheckpointedRun
from cadenza.learning.config import ImitationConfig
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.observation import Floats, Inputs, ObservationSpec, pruned
from cadenza.learning.policy_folder import save_policy
from cadenza.learning.ranges import Ranges
from cadenza.music.formats.reading import name_without_ending
from cadenza.resumable import Arrays
from cadenza.tasks.piano_task import PianoTask
from cadenza.tasks.view import from_range

_UPDATES_AT_ONCE = 20  # before the run may be stopped
_MAX_HELD_OUT = 5_000  # steps on which the error on held-out demonstrations is measured
_MAX_CACHED = 2**30  # bytes of examples; larger sets are computed anew for each update
_CACHED_AT_ONCE = 4_096  # examples
_LEARNT_FROM, _HELD_OUT = "learnt_from", "held_out"  # in run.json: names of episodes
_MIN_RANGE = 0.05  # least range of a joint or servo that hardly moves, as a share of its full one


class Examples(NamedTuple):
    """Observations (..., D) and the demonstrator's actions (..., A)."""

    observation: Floats
    action: Floats

    def at(self, steps: NDArray[np.intp]) -> Examples:
        """The examples of these rows."""
        return Examples(self.observation[steps], self.action[steps])


class Imitation(CheckpointedRun):
    """A run of training on demonstrations."""

    command: ClassVar[str] = "cadenza clone"

    def __init__(self, config: ImitationConfig, demonstrations: Path, folder: Path) -> None:
        """Go on with the run in `folder`, where no other process works, or begin it.

        It learns from what `cadenza dataset collect` has recorded in `demonstrations`.

        Raises CadenzaError if an option makes no sense, there are no such demonstrations or they do
        not go together, or the folder holds a run with other options.
        """
        config.check()
        rng = np.random.default_rng(config.seed)
        interval = config.checkpoint_interval
        super().__init__(self.folder_at(folder), config.num_updates, interval, rng)
        self.config = config
        demonstrations = dataset_folder(demonstrations)
        recorded = kept(demonstrations)
        learnt_from, held_out = self._split(recorded)
        episodes = {episode.folder.name: episode for episode in recorded}
        names = (*learnt_from, *held_out)
        if missing := set(names) - episodes.keys():
            raise CadenzaError(
                f"{demonstrations}: {min(missing)} is gone, which the run learns from"
            )
        scene = Dataset([episodes[name] for name in names]).scene  # or says what differs
        self._dataset = Dataset([episodes[name] for name in learnt_from])
        self.songs = tuple(sorted({episode.facts.song for episode in self._dataset.episodes}))
        first = self._dataset.episodes[0]
        self._task = replace(  # as is observed, see `observed`
            first.facts.task,
            n_steps_lookahead=config.n_steps_lookahead,
            n_seconds_lookahead=None,
            fingering="auto",
            trim_silence=True,
        )
        with closing(PianoTask([first.score], self._task, first.facts.scene)) as task:
            self._spec = ObservationSpec.of(task.spec)
            limits = np.stack([task.spec.action_low, task.spec.action_high])
        for name in names:  # read again, as arrays that stay read hold files open
            check_values(RecordedEpisode(episodes[name].folder, episodes[name].facts), scene)
        self._inputs = _inputs(self._spec, self._dataset, config.previous_action)
        self._ranges = _ranges(self._dataset, limits)
        self._held_out: Examples | None = None
        if held_out:
            others = Dataset([episodes[name] for name in held_out])
            every = -(-others.num_steps // _MAX_HELD_OUT)
            self._held_out = self._examples(others, np.arange(0, others.num_steps, every))
        with extra_packages("train", "training"):
            from cadenza.learning.algorithms.cloning.learner import Cloning
        ends = ((0, config.num_updates),)
        self._learner = Cloning(config.learner, self._inputs, limits.shape[1], ends)
        self._state = self._learner.init(config.seed)
        self._errors = np.zeros(0, np.float32)
        # The folder is written to only now that nothing else can fail.
        manifest = {"config": asdict(config), "demonstrations": str(demonstrations.resolve())}
        self.folder.begin_or_continue(manifest | {_LEARNT_FROM: learnt_from, _HELD_OUT: held_out})
        self.resume()

    def _split(self, recorded: Sequence[RecordedEpisode]) -> tuple[tuple[str, ...], ...]:
        """Names of episodes to learn from and held out; a run that has begun keeps its own."""
        if self.folder.begun:
            known = self.folder.read_manifest()
            names = [known.get(name) for name in (_LEARNT_FROM, _HELD_OUT)]
            return checked(names, tuple[tuple[str, ...], ...], self.folder.manifest)
        return _split(_by_song(recorded, self.config.songs), self.config.held_out)

    def _learn(self) -> dict[str, Any] | None:
        interval = self.config.log_interval
        to_log = interval - self.step % interval
        self._make_updates(min(_UPDATES_AT_ONCE, to_log, self.num_steps - self.step))
        return self._row() if self.finished or self.step % interval == 0 else None

    def _make_updates(self, updates: int) -> None:
        shape = updates, self.config.learner.batch_size
        steps = self._dataset.sample(self._rng, updates * shape[1])
        cached = self._cached
        flat = self._examples(self._dataset, steps) if cached is None else cached.at(steps)
        examples = Examples._make(array.reshape(*shape, -1) for array in flat)
        self._state, metrics = self._learner.update(self._state, examples)
        self._errors = np.concatenate([self._errors, np.asarray(metrics["error"])])
        if not np.isfinite(self._errors).all():  # before it is kept
            raise CadenzaError("the error is no longer finite; choose a smaller --learning-rate")
        self.step += updates

    @cached_property
    def _cached(self) -> Examples | None:
        """The examples of all steps, if they fit into memory and updates use most of them."""
        config, count = self.config, self._dataset.num_steps
        sizes = len(self._inputs.kept), self._ranges.actions.shape[1]
        needed = config.num_updates * config.learner.batch_size
        if np.dtype(np.float32).itemsize * sum(sizes) * count > _MAX_CACHED or needed < count:
            return None
        cached = Examples(*(np.empty((count, size), np.float32) for size in sizes))
        for first in range(0, count, _CACHED_AT_ONCE):
            steps = np.arange(first, min(first + _CACHED_AT_ONCE, count))
            cached.observation[steps], cached.action[steps] = self._examples(self._dataset, steps)
        return cached

    def _examples(self, dataset: Dataset, steps: NDArray[np.intp]) -> Examples:
        lookahead = self.config.n_steps_lookahead
        batch = dataset.batch(steps, lookahead)
        onsets = dataset.onsets(steps, lookahead) if dataset.shows_onsets else ()
        observation = observed(batch, self._ranges, onsets)[:, list(self._inputs.kept)]
        action = from_range(batch.action, *self._ranges.actions)
        return Examples(observation, action.astype(np.float32))

    def _row(self) -> dict[str, Any]:
        row = {"train/error": float(self._errors.mean())}
        if self._held_out is not None:
            row["held_out/error"] = self._learner.error(self._state, self._held_out)
        self._errors = self._errors[:0]
        return row

    def _arrays(self) -> Arrays:
        learner = self._learner.to_arrays(self._state)
        arrays = {f"learner:{name}": array for name, array in learner.items()}
        return arrays | {"errors": self._errors}

    def _save_result(self) -> None:
        learnt = LearntPolicy(
            policy=self._learner.policy(self._state),
            observation=self._spec,
            inputs=self._inputs,
            reference=None,
            ranges=self._ranges,
            task=self._task,
            scene=self._dataset.episodes[0].facts.scene,
            score=None,
        )
        save_policy(self.folder.path / "last", learnt, {"step": self.step, "songs": self.songs})

    def _restore(self, facts: dict[str, Any], arrays: Arrays) -> None:
        learner = {n.removeprefix("learner:"): a for n, a in arrays.items() if n != "errors"}
        self._state = self._learner.from_arrays(learner)
        self._errors = arrays["errors"]


def observed(batch: StepBatch, ranges: Ranges, onsets: Sequence[Floats] = ()) -> Floats:
    """Observations (B, D) of a policy without a reference, see `ObservationSpec`.

    Args:
        batch: The steps (B,).
        ranges: The ranges to which joints and the previous action are normalised.
        onsets: When notes begin and how loud they are (B, L + 2, K), if that is observed, see
            `Dataset.onsets`.
    """
    count = len(batch.goal)
    first = ~batch.previous_action.any(axis=1, keepdims=True)  # nothing was played before
    played = np.where(first, 0.0, from_range(batch.previous_action, *ranges.actions))
    parts = (
        batch.goal.reshape(count, -1),
        batch.fingering[:, 0],
        *(part.reshape(count, -1) for part in onsets),
        batch.key_state,
        batch.pedal[:, None],
        ranges.scaled(batch.hand_qpos),
        *((batch.key_onset, batch.key_velocity) if onsets else ()),
        played,
        batch.previous_reward[:, None],
    )
    return np.concatenate([part.astype(np.float32) for part in parts], axis=1)


def _inputs(spec: ObservationSpec, dataset: Dataset, previous_action: bool) -> Inputs:
    """Inputs without goals of keys that no demonstration asks for.

    The previous action and its reward are kept only if `previous_action`.
    """
    mask = np.zeros(spec.goals_of_a_step, bool)
    for number in range(len(dataset.episodes)):
        goals = dataset.goals(number)
        mask |= np.append(goals.keys.any(axis=0), goals.sustain.any())
    inputs = pruned(spec, mask, np.ones(spec.fingering, bool))
    end = spec.size if previous_action else spec.layout["previous_action"].start
    return Inputs(tuple(i for i in inputs.kept if i < end), spec.size)


def _ranges(dataset: Dataset, limits: NDArray[np.float64]) -> Ranges:
    """The ranges of joints and actions in the demonstrations.

    `limits` (2, A) are the least and the largest actions.
    """
    scene = dataset.scene
    joints = np.array([scene.model.joint(name).range for name in scene.hand_joint_names]).T
    steps = [episode.steps for episode in dataset.episodes]
    return Ranges(
        _used([some["hand_qpos"] for some in steps], joints),
        _used([some["action"][:-1] for some in steps], limits),
    )


def _used(arrays: Sequence[NDArray[Any]], limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """The range (2, N) of arrays (..., N), at least `_MIN_RANGE` of the limits (2, N)."""
    low = np.min([array.min(axis=0) for array in arrays], axis=0).astype(np.float64)
    high = np.max([array.max(axis=0) for array in arrays], axis=0).astype(np.float64)
    missing = np.maximum(_MIN_RANGE * (limits[1] - limits[0]) - (high - low), 0) / 2
    return np.clip(np.stack([low - missing, high + missing]), *limits)


def _by_song(
    episodes: Sequence[RecordedEpisode], songs: Sequence[str]
) -> dict[str, list[RecordedEpisode]]:
    """Episodes by song: those of `songs`, or of all if there are none."""
    by_song = defaultdict[str, list[RecordedEpisode]](list)
    for episode in episodes:
        by_song[episode.facts.song].append(episode)
    if not songs:
        return by_song
    return {song: by_song[song] for song in (_song_named(name, list(by_song)) for name in songs)}


def _song_named(name: str, songs: Sequence[str]) -> str:
    """The song of this name, or whose path ends in it.

    Raises CadenzaError if there is none, or there are several.
    """
    matches = [song for song in songs if name in (song, name_without_ending(song))]
    if name in matches:
        return name
    if not matches:
        names = ", ".join(map(name_without_ending, songs))
        raise CadenzaError(f"songs: no demonstration of {name}; there is {names}")
    if len(matches) > 1:
        raise CadenzaError(f"songs: {name} is {' and '.join(matches)}; give one of these")
    return matches[0]


def _split(
    songs: dict[str, list[RecordedEpisode]], held_out: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of episodes to learn from, at least one of each song, and of those held out."""
    learnt_from, others = [], []
    for episodes in songs.values():
        names = [episode.folder.name for episode in episodes]
        at = max(len(names) - held_out, 1)
        learnt_from += names[:at]
        others += names[at:]
    return tuple(learnt_from), tuple(others)
