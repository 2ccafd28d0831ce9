"""Training of a policy on a song or on several."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from cadenza.agents.agent import Progress, silent
from cadenza.learning.config import TrainingConfig, preset
from cadenza.learning.learnt_policy import LearntPolicy
from cadenza.learning.policy_folder import load_policy
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import begin
from cadenza.music.arrangement import SomeSong, load
from cadenza.music.libraries.songs import Song
from cadenza.music.score import Score
from cadenza.tasks.reward import RewardTerm


@dataclass(frozen=True)
class TrainingResult:
    """A training run that is over."""

    folder: Path
    """The folder of the run."""
    metrics: dict[str, Any]
    """The last value of each metric of the run, such as "eval/f1"."""
    policy: LearntPolicy
    """The policy that played best."""

    def __repr__(self) -> str:
        return f"TrainingResult({str(self.folder)!r}, F1 {self.metrics.get('eval/f1')})"


def train(
    song: SomeSong | Sequence[SomeSong],
    folder: str | Path,
    config: TrainingConfig | None = None,
    *,
    reward_terms: Mapping[str, RewardTerm] | None = None,
    progress: Progress = silent,
    **options: Any,
) -> TrainingResult:
    """Train a policy for a song or for several, as `cadenza train` does::

        trained = cadenza.train("TwinkleTwinkleLittleStar", "run", num_steps=200_000)
        print(cadenza.play(agent=trained.policy).metrics["f1"])

    Raises CadenzaError if the song is not there, an option makes no sense, the folder holds a run
    already, or JAX is not installed.

    Args:
        song: see `cadenza.play`; of several, each episode plays one.
        folder: of the run; nothing else may be in it. If the run is killed,
            `cadenza train --resume` continues it from the last checkpoint.
        config: how to train; by default the command's preset "fast".
        reward_terms: name -> function of a `cadenza.Outcome` that returns (N,), as of `PianoEnv`;
            a run with some cannot be resumed.
        progress: is called with how far it is, `progress("learning", done, total)`.
        options: fields of `TrainingConfig`, which change `config`.
    """
    songs = [song] if isinstance(song, Score | Song | str | Path) else song
    residual = options.get("residual", None if len(songs) == 1 else False)
    config = replace(config or preset("fast", residual), **options)
    scores = [load(each).written_for(config.scene.hands).score for each in songs]
    run = RunFolder(Path(folder))
    with run.locked(), closing(begin(config, scores, run, progress, reward_terms)) as training:

        def should_continue() -> bool:
            progress("learning", training.step, config.num_steps)
            return True

        training.run(should_continue)
        should_continue()
    metrics = {name: value for row in run.metrics.rows() for name, value in row.items()}
    return TrainingResult(run.path, metrics, load_policy(run.path))
