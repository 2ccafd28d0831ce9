"""`cadenza clone`, where a policy learns many songs from demonstrations."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.cli.arguments import Quiet
from cadenza.cli.console import stop_on_signal
from cadenza.cli.options import RecordedParts
from cadenza.cli.progress import progress
from cadenza.cli.saving import check_writable
from cadenza.errors import CadenzaError
from cadenza.learning.config import ImitationConfig

if TYPE_CHECKING:
    from cadenza.learning.imitation import Imitation


@dataclass(frozen=True)
class Clone(RecordedParts):
    """Train one policy for many songs on demonstrations, by behaviour cloning.

    Ctrl-C stops it. The same command continues it.

    Example: cadenza clone demonstrations -o clone; cadenza play OdeToJoy --agent clone/last
    """

    demonstrations: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATASET")]
    """A folder that "cadenza dataset collect" has made."""
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("runs/clone")
    """Folder of the run."""
    quiet: Quiet = False
    imitation: tyro.conf.OmitArgPrefixes[ImitationConfig] = field(default_factory=ImitationConfig)


def clone(command: Clone) -> None:
    from cadenza.files import locked
    from cadenza.learning.imitation import Imitation

    check_writable(command.output)
    with locked(command.output) as ours:
        if not ours:
            raise CadenzaError(f"{command.output}: another process is training this run")
        run = Imitation(command.imitation, command.demonstrations, command.output)
        _train(run)
    if not run.finished:
        raise KeyboardInterrupt
    policy = command.output / "last"
    print(f"learnt {len(run.songs)} songs; cadenza play SONG --agent {policy}")


def _train(run: Imitation) -> None:
    """Trains until the last update, or until a signal."""
    first, began = run.update, time.perf_counter()
    with progress("cloning", "updates", 30.0) as advance, stop_on_signal("a checkpoint") as stop:
        stop()  # from now on

        def goes_on() -> bool:
            remark = f"{(run.update - first) / (time.perf_counter() - began):.0f} a second"
            if run.error is not None:
                remark += f", error {run.error:.5f}"
            advance(run.update, run.config.num_updates, remark)
            return not stop()

        run.run(goes_on)
        goes_on()
