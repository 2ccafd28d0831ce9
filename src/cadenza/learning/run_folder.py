"""The folder of a run of `cadenza train`, with its options and songs.

RUN/run.json                  options, songs, the versions of the libraries
RUN/checkpoint.safetensors    learner, environments, random generators
RUN/replay/N.I.npz            the experience gathered up to step N since the file before
RUN/metrics.jsonl             metrics, a row a line
RUN/lock                      held by the process that trains it
RUN/best/, RUN/last/          the policy that played best, and that of the last checkpoint
"""

import secrets
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from cadenza.errors import CadenzaError, errors_in
from cadenza.files import checked
from cadenza.learning.checkpointed_run import LOCKED_OUT
from cadenza.learning.config import TrainingConfig, check
from cadenza.learning.learner import learner_config, name_of
from cadenza.learning.metrics_log import MetricsLog
from cadenza.music.formats.written_score import WrittenScore
from cadenza.music.score import Score
from cadenza.resumable import ResumableFolder, installed_versions
from cadenza.scene.config import check_modules

_VERSIONS = ("cadenza", "mujoco", "numpy", "jax", "flax", "optax")


@dataclass(frozen=True)
class _Manifest:
    config: TrainingConfig
    songs: tuple[WrittenScore, ...]
    versions: dict[str, str]
    id: str  # a random name, which no other run has
    learner: str  # the name of the learner
    reward_terms: tuple[str, ...] = ()  # names of the user's own


class RunFolder(ResumableFolder):
    """The folder of a run.

    Attributes:
        metrics: The log of metrics.
        replay: The path of the folder with the experience.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "cadenza train", LOCKED_OUT)
        self.metrics, self.replay = MetricsLog(path), path / "replay"

    def begin(
        self, config: TrainingConfig, scores: Sequence[Score], reward_terms: tuple[str, ...] = ()
    ) -> None:
        """Write down options, songs and names; raises CadenzaError if the folder holds a run."""
        if self.begun:
            raise CadenzaError(
                f"{self.path}: already holds a run; continue it with --resume {self.path}, or "
                "choose another folder with --output"
            )
        songs, learner = tuple(map(WrittenScore.of, scores)), name_of(config.learner)
        versions, run_id = installed_versions(_VERSIONS), secrets.token_hex(8)
        self.write_manifest(
            asdict(_Manifest(config, songs, versions, run_id, learner, reward_terms))
        )

    def set_end(self, config: TrainingConfig) -> None:
        """Change the number of steps to that of `config`; raises CadenzaError if more differs."""
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
        """The config and the scores, to go on with them.

        Raises CadenzaError if the folder holds no run, or one with a hand or a keyboard of a module
        that is not imported, or with reward terms of the user's own.
        """
        if terms := self._read().reward_terms:
            what = f"learns with a program's reward terms {', '.join(terms)}"
            raise CadenzaError(f"{self.path}: {what} and cannot be resumed; start a new run")
        config, scores = self.description()
        check_modules(config.scene, self.manifest)
        return config, scores

    def description(self) -> tuple[TrainingConfig, tuple[Score, ...]]:
        """The config and the scores, to be shown; raises CadenzaError if there is no run."""
        manifest = self._read()
        with errors_in(self.manifest):
            return manifest.config, tuple(song.score for song in manifest.songs)

    @property
    def id(self) -> str:
        """A name that no other run has, wherever they lie."""
        return self._read().id
