"""`cadenza generalist`, which trains networks of the agent generalist."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from cadenza.cli.arguments import Flat, Output, Quiet
from cadenza.cli.clone import train_until_stopped
from cadenza.cli.options import RecordedParts
from cadenza.cli.printing import stages
from cadenza.cli.saving import check_writable
from cadenza.errors import extra_packages
from cadenza.learning.algorithms.generalist.config import (
    ExcerptConfig,
    GeneralistCloningConfig,
    GeneralistReinforcementConfig,
    GeneralistStrikingConfig,
)
from cadenza.music.libraries.library import load_score, open_library
from cadenza.music.score import Score

if TYPE_CHECKING:
    from cadenza.learning.algorithms.generalist.excerpt_run import ExcerptRun


@dataclass(frozen=True)
class CloneGeneralist(RecordedParts):
    """Fit networks to how the planner corrects its plans.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza generalist clone demonstrations -o trained; cadenza play OdeToJoy --agent
    generalist --generalist.weights trained/weights.npz
    """

    demonstrations: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="DATASET...")
    ]
    """Folders that "cadenza dataset collect" has made, of at least three songs."""
    output: Output[Path] = Path("runs/generalist")
    """Folder of the run."""
    quiet: Quiet = False
    config: Flat[GeneralistCloningConfig] = field(default_factory=GeneralistCloningConfig)


@dataclass(frozen=True)
class _OverSongs:
    songs: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="LIBRARY")]
    """The library, or a split of it as LIBRARY:SPLIT."""
    weights: Path | None = None
    """File of the initial networks; by default, those that come with Cadenza."""
    quiet: Quiet = False


@dataclass(frozen=True)
class ReinforceGeneralist(_OverSongs):
    """Improve networks by reinforcement learning over the songs of a library.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza generalist reinforce LIBRARY:train --weights trained/weights.npz -o reinforced
    """

    output: Output[Path] = Path("runs/reinforced")
    """Folder of the run."""
    config: Flat[GeneralistReinforcementConfig] = field(
        default_factory=GeneralistReinforcementConfig
    )


@dataclass(frozen=True)
class StrikeGeneralist(_OverSongs):
    """Learn from the songs of a library how fingers strike, in time and as loud as written.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza generalist strike LIBRARY:train --weights reinforced/weights.npz -o striking
    """

    output: Output[Path] = Path("runs/striking")
    """Folder of the run."""
    config: Flat[GeneralistStrikingConfig] = field(default_factory=GeneralistStrikingConfig)


def clone(command: CloneGeneralist) -> None:
    with extra_packages("train", "training"):
        from cadenza.learning.algorithms.generalist.cloning import GeneralistCloning

    check_writable(command.output)
    with GeneralistCloning.folder_at(command.output).locked():
        with stages("reading") as progress:
            run = GeneralistCloning(
                command.config, command.demonstrations, command.output, progress
            )
        train_until_stopped(run, "fitting", "perceptrons", "train/explained_variance")
    _print_how_to_play(command.output)


def reinforce(command: ReinforceGeneralist) -> None:
    with extra_packages("train", "training"):
        from cadenza.learning.algorithms.generalist.reinforcement import GeneralistReinforcement

    _train(command, GeneralistReinforcement)


def strike(command: StrikeGeneralist) -> None:
    with extra_packages("train", "training"):
        from cadenza.learning.algorithms.generalist.striking import GeneralistStriking

    _train(command, GeneralistStriking)


def _train(command: ReinforceGeneralist | StrikeGeneralist, kind: type[ExcerptRun]) -> None:
    check_writable(command.output)
    with kind.folder_at(command.output).locked():
        scores = _excerpts(command.songs, command.config)
        with stages("planning") as progress:
            run = kind(
                command.config, command.songs, scores, command.output, command.weights, progress
            )
        train_until_stopped(run, "learning", "rounds", "train/cost")
    _print_how_to_play(command.output)


def _excerpts(library: str, config: ExcerptConfig) -> list[Score]:
    """Excerpts of songs of a library, with velocities of all kinds."""
    from cadenza.evaluation.collecting.variation import excerpt
    from cadenza.learning.algorithms.generalist.excerpts import with_dynamics

    rng, songs = np.random.default_rng(config.seed), open_library(library).songs
    drawn = rng.permutation(len(songs))[: config.num_songs].tolist()
    scores = [load_score(songs[i].name) for i in drawn]
    return [with_dynamics(excerpt(score, config.seconds, rng.random())[0], rng) for score in scores]


def _print_how_to_play(folder: Path) -> None:
    weights = folder / "weights.npz"
    print(f"cadenza play SONG --agent generalist --generalist.weights {weights}")
