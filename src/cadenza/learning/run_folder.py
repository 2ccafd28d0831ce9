"""A training run on disk: what it needs to go on after a kill at any moment.

RUN/run.json              what was asked for, and the versions of the libraries
RUN/checkpoints/N/        learner, environments, random generators after N control steps
RUN/replay/N.I.npz        the experience gathered up to N since the file before
RUN/metrics.jsonl         metrics, a row a line
RUN/lock                  held by the process that trains it
RUN/best/, RUN/last/      the policy that played best, and that of the last checkpoint
"""

from __future__ import annotations

import re
import secrets
import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from itertools import count, pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, errors_in
from cadenza.files import ANY, Expected, checked, read_arrays, remove_half_written, write_atomically
from cadenza.learning.checkpointed_run import LOCKED_OUT
from cadenza.learning.checksummed_folder import read_checksummed, write_checksummed
from cadenza.learning.config import TrainingConfig, check
from cadenza.learning.learner import learner_config, name_of
from cadenza.learning.metrics_log import MetricsLog
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.resumable import ResumableFolder, installed_versions
from cadenza.scene.config import check_modules

_VERSIONS = ("cadenza", "mujoco", "numpy", "jax", "flax", "optax")
_KIND = "checkpoint"
_MAX_HEADERS = 2**12  # bytes, of the arrays of experience
_NUM_CHECKPOINTS = 2  # should the newest be damaged, there is the one before
# Names of what is written here; other files are left alone.
_CHECKPOINT, _CHUNK = r"\d{12,}", r"\d{12,}\.\d+\.npz"

Count = Annotated[int, Meta(ge=0, le=2**53)]
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class _Manifest:
    """The content of run.json."""

    config: TrainingConfig
    songs: tuple[WrittenScore, ...]
    versions: dict[str, str]
    id: str
    """A random name, which no other run has."""
    learner: str
    """The name of the learner."""


@dataclass(frozen=True)
class Chunk:
    """A file of experience for the replay buffer."""

    file: Annotated[str, Meta(pattern=f"^{_CHUNK}$")]
    to: tuple[Count, ...]
    """The number of frames of each environment up to the end of the chunk."""

    @property
    def frames(self) -> int:
        """The number of frames of all environments up to its end."""
        return sum(self.to)


@dataclass(frozen=True)
class Facts:
    """The progress of a run, but for arrays."""

    step: Count
    seconds: float
    best: dict[str, float | None]
    """The row of the best evaluation."""
    sample_rng: dict[str, Any]
    collector: dict[str, Any]
    finished: tuple[tuple[float | None, float | None], ...]
    replay: tuple[Chunk, ...]
    ends: tuple[tuple[Count, Count], ...]
    """Pairs of a step and the last step at which the run was to end since then."""
    threads: int | None
    """Threads of the learner, if their number is known."""
    updates: Count
    """Updates of the learner so far."""
    metrics_size: Count = 0


class Checkpoint(NamedTuple):
    """A checkpoint with its experience, as `RunFolder.load` returns it."""

    facts: Facts
    arrays: Arrays
    replay: list[Arrays | None]
    """The experience of each chunk, None where it is lost."""


class RunFolder(ResumableFolder):
    """The files of a run, for the one process that trains it.

    Attributes:
        metrics: the log of metrics.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "cadenza train", LOCKED_OUT)
        self._checkpoints, self._replay = path / "checkpoints", path / "replay"
        self.metrics = MetricsLog(path)

    # What was asked for

    def begin(self, config: TrainingConfig, scores: Sequence[Score]) -> None:
        """Writes down what is asked for.

        Raises:
            CadenzaError: the folder holds a run already, or what is left of one.
        """
        if self.begun:
            raise CadenzaError(
                f"{self.path}: already holds a run; continue it with --resume {self.path}, or "
                "choose another folder with --output"
            )
        self.check_complete(bool(self._saved()))
        songs, learner = tuple(map(WrittenScore.of, scores)), name_of(config.learner)
        manifest = _Manifest(
            config, songs, installed_versions(_VERSIONS), secrets.token_hex(8), learner
        )
        self.write_manifest(asdict(manifest))

    def forget(self) -> None:
        """Deletes the manifest of a run that cannot be made: the folder is free for another."""
        self.manifest.unlink(missing_ok=True)

    def set_end(self, config: TrainingConfig) -> None:
        """Changes the number of steps to that of `config`.

        Raises:
            CadenzaError: it differs in something else too, or makes no sense.
        """
        manifest = self._read()
        check(config)
        if replace(config, num_steps=manifest.config.num_steps) != manifest.config:
            raise CadenzaError(
                f"{self.path}: a resumed run keeps its own options; leave out all but --num-steps"
            )
        if config != manifest.config:
            self.write_manifest(asdict(replace(manifest, config=config)))

    def _read(self) -> _Manifest:
        if not self.begun:
            raise CadenzaError(f"{self.path}: holds no run to resume; give the folder of a run")
        content = self.read_manifest()
        config = content.get("config")
        options = config.pop("learner", {}) if isinstance(config, dict) else {}
        manifest = checked(content, _Manifest, self.manifest)
        learner = checked(options, learner_config(manifest.learner), self.manifest)
        return replace(manifest, config=replace(manifest.config, learner=learner))

    def settings(self) -> tuple[TrainingConfig, tuple[Score, ...]]:
        """Returns the config and the scores, to go on with them.

        Raises:
            CadenzaError: the folder holds no run, or one whose hand or keyboard is of a module that
                nobody has imported.
        """
        config, scores = self.description()
        check_modules(config.scene, self.manifest)
        return config, scores

    def description(self) -> tuple[TrainingConfig, tuple[Score, ...]]:
        """Returns the config and the scores, to be shown.

        Raises:
            CadenzaError: the folder holds no run.
        """
        manifest = self._read()
        with errors_in(self.manifest):
            return manifest.config, tuple(song.score for song in manifest.songs)

    @property
    def id(self) -> str:
        """A name that no other run has, wherever they lie."""
        return self._read().id

    def add_row(self, row: dict[str, float]) -> None:
        """Appends a row of metrics.

        Raises:
            CadenzaError: there is no room.
        """
        with self._disk_errors():
            self.metrics.add(row)

    # Checkpoints

    def save_experience(self, step: int, experience: Arrays) -> str:
        """Writes the experience since the last checkpoint; returns the name of its file."""
        names = (f"{step:012}.{number}.npz" for number in count())
        # That of a checkpoint at the same step is still needed.
        name = next(name for name in names if not (self._replay / name).exists())
        with self._disk_errors(), write_atomically(self._replay / name) as file:
            np.savez(file, allow_pickle=False, **experience)
        return name

    def save(self, facts: Facts, arrays: Arrays) -> None:
        """Writes a checkpoint, and deletes what no checkpoint needs any more.

        Args:
            facts: The progress, with chunks named by `save_experience`; `metrics_size` is set here.
            arrays: The arrays of the checkpoint.

        Raises:
            CadenzaError: there is no room; the checkpoint before this is still there.
        """
        with self._disk_errors():
            folder = self._checkpoints / f"{facts.step:012}"
            facts = replace(facts, metrics_size=self.metrics.size)
            write_checksummed(folder, _KIND, asdict(facts), arrays)
        for old in self._saved()[:-_NUM_CHECKPOINTS]:
            shutil.rmtree(old, ignore_errors=True)
        needed: set[str] = set()
        for folder in self._saved():
            try:
                needed |= {chunk.file for chunk in _read_checkpoint(folder)[0].replay}
            except CadenzaError:
                return  # what a damaged one needs is not known
        for path in self._named(self._replay, _CHUNK):
            if path.name not in needed:
                path.unlink()

    def load(
        self, expected: Expected = ANY, most_experience: int | None = None
    ) -> Checkpoint | None:
        """Returns the intact checkpoint from which least is lost, as a rule the newest.

        What was done since is lost, and experience whose file is lost; both are counted in control
        steps. Damaged files are named on standard error. Metrics of later steps are dropped.

        Args:
            expected: The arrays of a checkpoint.
            most_experience: The bytes that the experience of one file may take.

        Raises:
            CadenzaError: there are only damaged ones.
        """
        self._drop_unfinished()
        saved = self._saved()
        if not saved:
            self.metrics.delete()
            return None
        found = self._intact(saved, expected, most_experience)
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
        with self._disk_errors():
            self.metrics.truncate(found[best].facts.metrics_size)
        return found[best]

    def _intact(
        self, saved: list[Path], expected: Expected, most_experience: int | None
    ) -> dict[Path, Checkpoint]:
        """Returns the newest intact checkpoints, down to one that has lost nothing."""
        found: dict[Path, Checkpoint] = {}
        chunks: dict[str, Arrays | None] = {}
        for folder in reversed(saved):
            try:
                facts, arrays = _read_checkpoint(folder, expected)
            except CadenzaError as error:
                print(error, file=sys.stderr)
                continue
            names = [chunk.file for chunk in facts.replay]
            missing = (name for name in names if name not in chunks)
            chunks |= {name: self._chunk(name, most_experience) for name in missing}
            found[folder] = Checkpoint(facts, arrays, [chunks[name] for name in names])
            if not _lost(found[folder]):
                break
        return found

    def _chunk(self, name: str, most: int | None) -> Arrays | None:
        try:
            return read_arrays(self._replay / name, ANY, most and most + _MAX_HEADERS)
        except CadenzaError as error:
            print(error, file=sys.stderr)
            return None

    def _drop_unfinished(self) -> None:
        """Deletes what was being written when the process was killed."""
        for aside in self._named(self._checkpoints, rf"\.{_CHECKPOINT}\.old"):
            kept = aside.with_name(aside.stem[1:])
            if not kept.exists():  # the process was killed between two renames
                aside.rename(kept)
        for unfinished in self._named(self._checkpoints, rf"\.{_CHECKPOINT}\.(new|old)"):
            shutil.rmtree(unfinished, ignore_errors=True)
        for folder in (self.path, self._checkpoints, self._replay):
            remove_half_written(folder)

    def _saved(self) -> list[Path]:
        return sorted(path for path in self._named(self._checkpoints, _CHECKPOINT) if path.is_dir())

    @staticmethod
    def _named(folder: Path, pattern: str) -> list[Path]:
        there = folder.iterdir() if folder.is_dir() else ()
        return [path for path in there if re.fullmatch(pattern, path.name, re.ASCII)]

    @contextmanager
    def _disk_errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise CadenzaError(
                f"{self.path}: could not be written ({error.strerror}); the last checkpoint "
                f"can still be loaded. Once there is room: cadenza train --resume {self.path}"
            ) from error


def _read_checkpoint(
    folder: Path, expected: Expected = MappingProxyType({})
) -> tuple[Facts, Arrays]:
    plain, arrays = read_checksummed(folder, _KIND, expected)
    return checked(plain, Facts, folder / "facts.json"), arrays


def _lost(checkpoint: Checkpoint) -> int:
    """Returns the number of frames in lost chunks."""
    ends = [0, *(chunk.frames for chunk in checkpoint.facts.replay)]
    return sum(
        end - start
        for (start, end), chunk in zip(pairwise(ends), checkpoint.replay, strict=True)
        if chunk is None
    )
