"""`cadenza clone`, `generalist` and `publish`: policies for many songs, and for others."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from cadenza.cli.arguments import Flat, Output, Quiet
from cadenza.cli.options import RecordedParts
from cadenza.cli.progress import SECONDS_BETWEEN_LINES_OF_TRAINING, progress, stages, stop_on_signal
from cadenza.cli.saving import check_writable
from cadenza.errors import counted, extra_packages
from cadenza.learning.algorithms.generalist.config import (
    ExcerptConfig,
    GeneralistCloningConfig,
    GeneralistReinforcementConfig,
    GeneralistStrikingConfig,
)
from cadenza.learning.config import ImitationConfig
from cadenza.music.libraries.library import load_score, open_library
from cadenza.music.score import Score

if TYPE_CHECKING:
    from cadenza.learning.algorithms.generalist.excerpts import ExcerptRun
    from cadenza.learning.checkpointed_run import CheckpointedRun


@dataclass(frozen=True)
class Clone(RecordedParts):
    """Train one policy for many songs on demonstrations, by behaviour cloning.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza clone demonstrations -o clone; cadenza play OdeToJoy --agent clone/last
    """

    demonstrations: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """A folder that "cadenza dataset collect" has made."""
    output: Output[Path] = Path("runs/clone")
    """Folder of the run."""
    quiet: Quiet = False
    imitation: Flat[ImitationConfig] = field(default_factory=ImitationConfig)


def clone(command: Clone) -> None:
    from cadenza.learning.imitation import Imitation

    check_writable(command.output)
    with Imitation.folder_at(command.output).locked():
        run = Imitation(command.imitation, command.demonstrations, command.output)
        train_until_stopped(run, "cloning", "updates", "train/error")
    policy = command.output / "last"
    print(f"learnt {counted(len(run.songs), 'song')}; cadenza play SONG --agent {policy}")


def train_until_stopped(run: CheckpointedRun, stage: str, unit: str, metric: str) -> None:
    """Train until all updates are done, or until a signal, which saves a checkpoint first.

    The progress counts `unit` (plural), and shows a `metric` of the run. Raises KeyboardInterrupt
    if there was a signal.
    """
    first, began = run.step, time.perf_counter()
    shown = progress(stage, unit, SECONDS_BETWEEN_LINES_OF_TRAINING)
    with shown as advance, stop_on_signal("a checkpoint") as stop:
        stop()  # signals are caught from its first call on

        def should_continue() -> bool:
            remark = f"{(run.step - first) / (time.perf_counter() - began):.3g} a second"
            if run.rows and (value := run.rows[-1].get(metric)) is not None:
                remark += f", {metric.rpartition('/')[2].replace('_', ' ')} {value:.5f}"
            advance(run.step, run.num_steps, remark)
            return not stop()

        run.run(should_continue)
        should_continue()
    if not run.finished:
        raise KeyboardInterrupt


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
    """The options of training over the songs of a library."""

    songs: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="LIBRARY")]
    """The library, or a split of it as LIBRARY:SPLIT."""
    weights: Path | None = None
    """File of the networks to begin with; by default, those that come with Cadenza."""
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


def clone_generalist(command: CloneGeneralist) -> None:
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
    """Return excerpts of songs of a library, with velocities of all kinds."""
    from cadenza.evaluation.collecting.variation import excerpt
    from cadenza.learning.algorithms.generalist.excerpts import with_dynamics

    rng, songs = np.random.default_rng(config.seed), open_library(library).songs
    drawn = rng.permutation(len(songs))[: config.num_songs].tolist()
    scores = [load_score(songs[i].name) for i in drawn]
    return [with_dynamics(excerpt(score, config.seconds, rng.random())[0], rng) for score in scores]


def _print_how_to_play(folder: Path) -> None:
    weights = folder / "weights.npz"
    print(f"cadenza play SONG --agent generalist --generalist.weights {weights}")


@dataclass(frozen=True)
class Publish:
    """Upload a policy or demonstrations to the Hugging Face hub.

    Example: cadenza publish run/best me/twinkle; cadenza play --agent hub:me/twinkle
    """

    folder: tyro.conf.Positional[Path]
    """Folder of a policy or of "cadenza dataset collect"; a README.md in it is the card."""
    name: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="OWNER/NAME")]
    """Name on the hub."""
    quiet: Quiet = False


def publish_folder(command: Publish) -> None:
    from cadenza.learning.publishing import publish

    print(publish(command.folder, command.name))
