"""Runs that train the generalist on excerpts of songs.

RUN/weights.npz     the networks of the run
"""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from cadenza.agents.agent import Progress, silent
from cadenza.agents.generalist.generalist import shipped_for
from cadenza.agents.planner.search.networks.inputs import sizes_of
from cadenza.agents.planner.search.networks.weights import Weights
from cadenza.errors import CadenzaError
from cadenza.files import sha256_of
from cadenza.learning.algorithms.generalist.config import ExcerptConfig
from cadenza.learning.algorithms.generalist.excerpts import ExcerptEnvs, planned_excerpts
from cadenza.learning.algorithms.on_jax import start_jax
from cadenza.learning.checkpointed_run import CheckpointedRun
from cadenza.music.score import Score
from cadenza.scene.scene import Scene, build_scene


class ExcerptRun(CheckpointedRun):
    """A run on excerpts. A resumed run begins them anew, and may have another `num_rounds`."""

    def __init__(
        self,
        config: ExcerptConfig,
        library: str,
        scores: Sequence[Score],
        folder: Path,
        weights: Path | None = None,
        progress: Progress = silent,
    ) -> None:
        """Resume the run in `folder`, or begin it on `scores`, excerpts of songs of a `library`.

        It begins with the networks in the file `weights`, by default those of Cadenza; `progress`
        counts the excerpts that are planned.

        Raises CadenzaError if an option makes no sense, there is no score, the networks are of
        other hands, or the folder holds a run with other options.
        """
        config.check()
        if not scores:
            raise CadenzaError(f"{library}: no songs to play")
        rng = np.random.default_rng(config.seed)
        interval = config.checkpoint_interval
        super().__init__(self.folder_at(folder), config.num_rounds, interval, rng)
        start_jax()
        self.config, scene = config, build_scene()
        initial = _initial_weights(scene, weights)
        options = asdict(config)
        manifest = {"num_rounds": options.pop("num_rounds"), "config": options, "library": library}
        manifest["weights"] = None if weights is None else sha256_of(weights)
        self.folder.begin_or_continue(manifest, changeable=("num_rounds",))
        self._prepare(initial, scene)
        self.resume()
        if not self.finished:
            excerpts = planned_excerpts(scores, progress)
            self._envs = ExcerptEnvs(excerpts, scene, config.num_envs, self._rng)

    @abstractmethod
    def _prepare(self, initial: Weights, scene: Scene) -> None:
        """Begin with these networks, before a checkpoint is restored."""


def _initial_weights(scene: Scene, path: Path | None) -> Weights:
    """The networks of a file, by default Cadenza's; raises CadenzaError if of other hands."""
    weights = shipped_for(scene) if path is None else Weights.load(path)
    if weights is None or weights.sizes != sizes_of(scene):
        raise CadenzaError(f"{path}: networks of other hands than {scene.hand.name}")
    return weights
