"""The command line: a module a sub-command, or two that belong together.

What is heavy to import is imported by the function that needs it, so that --help is quick.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from io import TextIOWrapper
from typing import Annotated, Any, TextIO, Union

import tyro

from cadenza.cli import about, compare, plan, play, train
from cadenza.cli.performing import Performing
from cadenza.errors import CadenzaError, CadenzaWarning

_PERFORMS: dict[type, Callable[[Any, Callable[[Any], Any]], None]] = {
    play.Play: play.play,
    plan.Plan: plan.plan,
    compare.Compare: compare.compare,
}
"""What also wants to read the command line again, over other defaults."""
_COMMANDS: dict[type, Callable[[Any], None]] = {
    train.Train: train.train,
    train.Curves: train.curves,
    about.Songs: about.songs,
    about.Info: about.info,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; exits 0 when done, 2 on wrong input, 130 when interrupted."""
    if isinstance(sys.stdout, TextIOWrapper):  # as stderr: names of files need not be text
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        arguments = sys.argv[1:] if arguments is None else arguments
        training = train.begins_with(arguments)
        command = _read(arguments, train.Train(training=training))
        with _warnings_in_a_line():
            if isinstance(command, Performing):
                _PERFORMS[type(command)](command, partial(_read, arguments))
            else:
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


def _read(arguments: Sequence[str], default: Any) -> Any:
    """The command of a command line; `default` is what it begins with if it is of that kind."""
    kinds: Any = tuple(
        Annotated[
            kind,
            tyro.conf.subcommand(
                kind.__name__.lower(),
                default=default if isinstance(default, kind) else tyro.MISSING_NONPROP,
            ),
        ]
        for kind in (*_PERFORMS, *_COMMANDS)
    )
    return tyro.cli(
        Union[kinds],  # noqa: UP007 - made of what there is
        prog="cadenza",
        description="Two simulated robot hands play the piano from any MIDI file.",
        args=arguments,
    )


@contextmanager
def _warnings_in_a_line() -> Iterator[None]:
    """Ours are for whoever typed the command, not for whoever wrote it."""

    show = warnings.showwarning

    def print_ours(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if issubclass(category, CadenzaWarning):
            print(message, file=sys.stderr)
        else:
            show(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        warnings.simplefilter("always", CadenzaWarning)
        warnings.showwarning = print_ours
        yield
