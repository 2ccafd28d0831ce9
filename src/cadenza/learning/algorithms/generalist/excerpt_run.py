"""Training of the generalist on excerpts of songs, which are played many at once.

RUN/weights.npz     the networks
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from cadenza.agents.agent import Progress, silent
from cadenza.agents.generalist.generalist import shipped_for
from cadenza.agents.planner.search.networks.inputs import sizes_of
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.errors import CadenzaError
from cadenza.files import NUMBERS, ArrayOf, Expected, plain, sha256_of
from cadenza.learning.algorithms.generalist.config import ExcerptConfig
from cadenza.learning.algorithms.generalist.excerpts import ExcerptEnvs, planned_excerpts
from cadenza.learning.algorithms.on_jax import start_jax
from cadenza.learning.checkpointed_run import CheckpointedRun
from cadenza.music.score import Score
from cadenza.scene.scene import Scene, build_scene


@dataclass(frozen=True)
class _Manifest:
    """The content of run.json."""

    config: dict[str, Any]
    library: str
    weights: str
    """SHA-256 of the networks to begin with; empty for those of Cadenza."""


class ExcerptRun(CheckpointedRun):
    """A run of training on excerpts; when it is resumed, they begin anew.

    Another `num_rounds` changes its end.
    """

    expected: ClassVar[Expected] = {"*": ArrayOf(NUMBERS, None)}

    def __init__(
        self,
        config: ExcerptConfig,
        library: str,
        scores: Sequence[Score],
        folder: Path,
        weights: Path | None = None,
        progress: Progress = silent,
    ) -> None:
        """Resumes the run in `folder`, if there is one.

        Args:
            config: its options.
            library: the name of the library.
            scores: excerpts of its songs.
            folder: The folder of the run.
            weights: file of the networks to begin with; by default those of Cadenza.
            progress: The function that is told how many excerpts have been planned.

        Raises:
            CadenzaError: an option makes no sense, there is no score, the networks are of other
                hands, or the folder holds a run with other options.
        """
        config.check()
        if not scores:
            raise CadenzaError(f"{library}: no songs to play")
        super().__init__(folder, config.num_rounds, config.checkpoint_interval, config.seed)
        start_jax()
        self.config, scene = config, build_scene()
        initial = _initial_weights(scene, weights)
        digest = "" if weights is None else sha256_of(weights)
        manifest = _Manifest(plain(asdict(config)), library, digest)
        self.folder.check_complete(self.has_checkpoint)
        if (known := self.folder.known(_Manifest)) is not None:
            known = replace(known, config=known.config | {"num_rounds": config.num_rounds})
        self.folder.begin_or_continue(manifest, known)
        self._prepare(initial, scene)
        self.resume()
        if not self.finished:
            excerpts = planned_excerpts(scores, progress)
            self._envs = ExcerptEnvs(excerpts, scene, config.num_envs, self._rng)

    @abstractmethod
    def _prepare(self, initial: Weights, scene: Scene) -> None:
        """Begins with these networks, before a checkpoint is restored."""


def _initial_weights(scene: Scene, path: Path | None) -> Weights:
    """Returns the networks of a file, by default those of Cadenza for the hands of a scene.

    Raises:
        CadenzaError: they are of other hands, or the file is damaged.
    """
    weights = shipped_for(scene) if path is None else Weights.load(path)
    if weights is None or weights.sizes != sizes_of(scene):
        raise CadenzaError(f"{path}: networks of other hands than {scene.hand.name}")
    return weights
