"""Trains a policy on a song or on several."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from cadenza.agents.agent import Progress, silent
from cadenza.learning.config import TrainingConfig, preset
from cadenza.learning.run_folder import RunFolder
from cadenza.learning.training import begin
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import Score
from cadenza.performing.source import Song, load_song


def train(
    song: Song | Sequence[Song],
    folder: str | Path,
    config: TrainingConfig | None = None,
    *,
    progress: Progress = silent,
    **options: Any,
) -> Path:
    """Trains a policy for a song or for several, as `cadenza train` does::

        best = cadenza.train("TwinkleTwinkleLittleStar", "run", num_steps=200_000)
        print(cadenza.play(best).metrics["f1"])

    Args:
        song: see `cadenza.play`; of several, each episode plays one.
        folder: of the run; nothing else may be in it. If the run is killed,
            `cadenza train --resume` continues it from the last checkpoint.
        config: how to train; by default the command's preset "fast".
        progress: is told how far it is, `progress("learning", done, total)`.
        options: fields of `TrainingConfig`, which change `config`.

    Returns:
        The folder of the policy that played best, to be given to `cadenza.play`.

    Raises:
        CadenzaError: the song is not there, an option makes no sense, the folder holds a run
            already, or JAX is not installed.
    """
    config = replace(config or preset("fast"), **options)
    songs = [song] if isinstance(song, Score | str | Path) else song
    whole = [each if isinstance(each, Score) else load_song(each) for each in songs]
    scores = [Arrangement().written_for(config.scene.hands, score) for score in whole]
    run = RunFolder(Path(folder))
    with run.locked(), closing(begin(config, scores, run)) as training:

        def should_continue() -> bool:
            progress("learning", training.step, config.num_steps)
            return True

        training.run(should_continue)
        should_continue()
    return run.path / "best"
