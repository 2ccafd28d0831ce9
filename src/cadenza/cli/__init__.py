"""The command line: a module a sub-command, or two that belong together.

What is heavy to import is imported by the function that needs it, so that --help is quick.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial
from io import TextIOWrapper
from itertools import pairwise
from typing import Any, NoReturn, TextIO, get_args

from cadenza.cli import (
    about,
    bench,
    clone,
    compare,
    dataset,
    etude,
    importing,
    plan,
    play,
    practice,
    results,
    songs,
    studio,
    train,
)
from cadenza.cli.arguments import (
    Shell,
    about_in_a_line,
    help_or_completion,
    option_parts,
    parse,
    similar,
    with_numbers_apart,
)
from cadenza.cli.performing import Options, with_options_of_agents
from cadenza.cli.progress import QUIET
from cadenza.cli.renamed import with_new_names
from cadenza.cli.setups import with_options_of_setup
from cadenza.errors import CadenzaError, CadenzaWarning, explained, lacks_memory
from cadenza.learning.learner import LEARNERS
from cadenza.registry import module_of

_Command = tuple[type, Callable[..., None]]
_COMMANDS: dict[str, _Command | dict[str, _Command]] = {
    "play": (play.PlayCommand, play.run),
    "plan": (plan.PlanCommand, plan.run),
    "studio": (studio.StudioCommand, studio.run),
    "practice": (practice.PracticeCommand, practice.run),
    "compare": (compare.Compare, compare.compare),
    "bench": (bench.Bench, bench.run),
    "results": (results.Results, results.results),
    "train": (train.Train, train.train),
    "clone": (clone.Clone, clone.clone),
    "curves": (train.Curves, train.curves),
    "songs": (songs.Songs, songs.songs),
    "libraries": (songs.Libraries, songs.libraries),
    "import": (importing.Import, importing.run),
    "info": (about.Info, about.info),
    "etude": (etude.Etude, etude.etude),
    "dataset": {
        "collect": (dataset.Collect, dataset.collect),
        "info": (dataset.DatasetInfo, dataset.info),
        "check": (dataset.DatasetCheck, dataset.check),
        "play": (dataset.DatasetPlay, dataset.play),
        "export": (dataset.DatasetExport, dataset.export),
    },
}
"""A command, or several under one name."""
_ABOUT = {"dataset": "Record demonstrations to learn from, and use them"}
"""What several commands under one name are for."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; exits 0 when done, 2 on wrong input, 130 when interrupted."""
    _open_closed_streams()
    if isinstance(sys.stdout, TextIOWrapper):  # as stderr: names of files need not be text
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        try:
            _run(sys.argv[1:] if arguments is None else list(arguments))
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # whoever read the output has left, as `head` does
        _exit(1)
    except (CadenzaError, OSError) as error:
        _exit(2, explained(error))
    except Exception as error:
        if not lacks_memory(error):
            raise
        _exit(2, explained(error))
    except KeyboardInterrupt:
        _exit(130, "interrupted")


def _run(arguments: list[str]) -> None:
    arguments = with_new_names(arguments)
    name, *rest = arguments or [""]
    if name not in _COMMANDS:
        _run_without_command(arguments)
        return
    if any(":" in word for word in rest) and "" not in sys.path:
        sys.path.append("")  # `module:Name` of an agent or a hand may lie in the working folder
    chosen = _COMMANDS[name]
    if isinstance(chosen, dict):
        if not rest or rest[0] not in chosen:
            _run_without_one_of(name, chosen, rest)
            return
        name, chosen, rest = f"{name} {rest[0]}", chosen[rest[0]], rest[1:]
    kind, run = chosen
    rest = with_options_of_setup(kind, with_numbers_apart(rest))
    _check_output(rest)
    _load_chosen(rest)
    if issubclass(kind, Options):
        kind = with_options_of_agents(kind, rest)
    default = train.Train(training=train.begins_with(arguments)) if name == "train" else None
    read = partial(parse, kind, f"cadenza {name}", rest)
    command = read(default)
    with _warnings_in_a_line(), _quietly(getattr(command, "quiet", False)):
        if isinstance(command, Options):  # and may read its options over other defaults
            run(command, read)
        else:
            run(command)


def _check_output(words: Sequence[str]) -> None:
    """Raises: CadenzaError: it is given without a name, which would be the working folder."""
    for option, name in pairwise(option_parts(words)):
        if option in ("-o", "--output", "--folder", "--runs") and not name:
            raise CadenzaError(f"{option}: the name is empty; give one, or . for this folder")


def _load_chosen(words: Sequence[str]) -> None:
    """Loads what is given as `module:NAME` and files may name: those can have nothing imported."""
    parts = option_parts(words)
    for option, name in pairwise(parts):
        if module_of(name) is None:
            continue
        if option == "--hand":
            from cadenza.hands.registry import hand_named

            hand_named(name)
        elif option == "--keyboard":
            from cadenza.keyboards.registry import keyboard_named

            keyboard_named(name)
        elif option == "--learner":
            LEARNERS.load(name, type)


@contextmanager
def _quietly(quiet: bool) -> Iterator[None]:
    """Shows no progress and no results if it is to be `quiet`."""
    if not quiet:
        yield
        return
    token = QUIET.set(True)
    try:
        with open(os.devnull, "w", errors="backslashreplace") as nowhere, redirect_stdout(nowhere):
            yield
    finally:
        QUIET.reset(token)


def _run_without_command(arguments: list[str]) -> None:
    match arguments:
        case ["--version"]:
            from importlib.metadata import version

            print(f"cadenza {version('cadenza')}")
        case ["-h" | "--help" | "--help-all", *_]:
            _about_all(["--help"])
        case ["--completion", shell] if shell in get_args(Shell):
            _about_all(arguments)
        case ["--completion", *_]:
            raise CadenzaError(f"--completion: choose from {', '.join(get_args(Shell))}")
        case []:
            raise CadenzaError(f"name a command: {', '.join(_COMMANDS)}; see cadenza --help")
        case [word, *_]:
            what = "option" if word.startswith("-") else "command"
            known = [*_COMMANDS, "--help", "--version", "--completion"]
            meant = similar(word, known) or "; see cadenza --help"
            raise CadenzaError(f"there is no {what} {word}{meant}")


def _run_without_one_of(name: str, commands: dict[str, _Command], words: list[str]) -> None:
    if words and words[0] in ("-h", "--help", "--help-all"):
        print(f"usage: cadenza {name} {{{','.join(commands)}}} ...\n")
        for one, (kind, _) in commands.items():
            print(f"cadenza {name} {one}: {about_in_a_line(kind)}")
        print(f'\nRun "cadenza {name} COMMAND --help" for the options of a command.')
        return
    given = " ".join([name, *words[:1]])
    raise CadenzaError(f"cadenza {given}: choose from {', '.join(commands)}")


def _about_all(arguments: list[str]) -> None:
    help_or_completion(
        _kinds(_COMMANDS),
        _ABOUT,
        "cadenza",
        "Two simulated robot hands play the piano from any MIDI file.\n\n"
        'Run "cadenza COMMAND --help" for the options of a command.',
        arguments,
    )


def _kinds(commands: Mapping[str, Any]) -> dict[str, Any]:
    """Name -> what it is read as, or several of them."""
    return {
        name: _kinds(command) if isinstance(command, dict) else _with_all_options(command[0])
        for name, command in commands.items()
    }


def _with_all_options(kind: type) -> type:
    return with_options_of_agents(kind, []) if issubclass(kind, Options) else kind


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
            print(_on_one_line(str(message)), file=sys.stderr)
        else:
            show(message, category, filename, lineno, file, line)

    with warnings.catch_warnings():
        warnings.simplefilter("default", CadenzaWarning)  # each once
        warnings.showwarning = print_ours
        yield


def _open_closed_streams() -> None:
    """Where the caller has closed stdin, stdout or stderr, nothing is read and what is said lost.

    They are opened in this order, so that no file of ours is taken for one of them.
    """
    for name, mode in ("stdin", "r"), ("stdout", "w"), ("stderr", "w"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, errors="backslashreplace"))  # noqa: SIM115 - as long as we run


def _on_one_line(message: str) -> str:
    """Whatever characters the name of a file in it has."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)


def _exit(status: int, message: str = "") -> NoReturn:
    """Says why, and drops what cannot be written, of which Python would complain at its end."""
    with suppress(OSError):
        if message:
            print(f"cadenza: {_on_one_line(message)}", file=sys.stderr)
    for stream in sys.stdout, sys.stderr:
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(status)
