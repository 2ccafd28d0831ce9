"""The command line: a module a sub-command, or two that belong together.

What is heavy to import is imported by the function that needs it, so that --help is quick.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any, Union

import tyro

from cadenza.cli import about, compare, plan, play, train
from cadenza.errors import CadenzaError

_COMMANDS: dict[type, Callable[[Any], None]] = {
    play.Play: play.play,
    plan.Plan: plan.plan,
    compare.Compare: compare.compare,
    train.Train: train.train,
    train.Curves: train.curves,
    about.Songs: about.songs,
    about.Info: about.info,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; exits 0 when done, 2 on wrong input, 130 when interrupted."""
    try:
        arguments = sys.argv[1:] if arguments is None else arguments
        training = train.begins_with(arguments)
        defaults: dict[type, Any] = {train.Train: train.Train(training=training)}
        kinds: Any = tuple(
            Annotated[
                kind,
                tyro.conf.subcommand(
                    kind.__name__.lower(), default=defaults.get(kind, tyro.MISSING_NONPROP)
                ),
            ]
            for kind in _COMMANDS
        )
        command = tyro.cli(
            Union[kinds],  # noqa: UP007 - made of what there is
            prog="cadenza",
            description="Two simulated robot hands play the piano from any MIDI file.",
            args=arguments,
        )
        _COMMANDS[type(command)](command)
        sys.stdout.flush()
    except BrokenPipeError:  # whoever read the output has left, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except (CadenzaError, OSError) as error:
        print(f"cadenza: {error}", file=sys.stderr)
        sys.exit(2)
    except RuntimeError as error:
        if "MUJOCO_GL" not in str(error):  # what MuJoCo says of a backend that it does not know
            raise
        print(f"cadenza: {error}; unset it, or choose egl or osmesa", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("cadenza: interrupted", file=sys.stderr)
        sys.exit(130)
