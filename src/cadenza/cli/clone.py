"""`cadenza clone`, where a policy learns many songs from demonstrations."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.cli.arguments import Flat, Output, Quiet
from cadenza.cli.options import RecordedParts
from cadenza.cli.printing import SECONDS_BETWEEN_LINES_OF_TRAINING, progress, stop_on_signal
from cadenza.cli.saving import check_writable
from cadenza.errors import counted
from cadenza.learning.config import ImitationConfig

if TYPE_CHECKING:
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
    """Train until all updates are done, or until a signal, after a checkpoint.

    The progress counts `unit` (plural), and shows a `metric` of the run. Raises KeyboardInterrupt
    after a signal.
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
