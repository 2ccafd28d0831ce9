"""The command line: a module a command, or two that belong together.

What is heavy to import is imported by the function that needs it, so that --help is quick.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from io import TextIOWrapper
from typing import Any, NoReturn, get_args

from cadenza.cli import (
    bench,
    clone,
    compare,
    dataset,
    etude,
    generalist,
    importing,
    info,
    plan,
    play,
    practice,
    results,
    songs,
    studio,
    train,
)
from cadenza.cli.arguments import (
    Chosen,
    Shell,
    about_in_a_line,
    choose,
    help_or_completion,
    parse,
    similar,
)
from cadenza.cli.console import on_one_line, open_closed_streams, quietly, warnings_in_a_line
from cadenza.cli.options import Options, reader, with_options_of_agents
from cadenza.errors import CadenzaError, explained, lacks_memory
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
    "info": (info.Info, info.info),
    "etude": (etude.Etude, etude.etude),
    "dataset": {
        "collect": (dataset.Collect, dataset.collect),
        "info": (dataset.DatasetInfo, dataset.info),
        "check": (dataset.DatasetCheck, dataset.check),
        "play": (dataset.DatasetPlay, dataset.play),
        "export": (dataset.DatasetExport, dataset.export),
    },
    "generalist": {
        "clone": (generalist.CloneGeneralist, generalist.clone),
        "reinforce": (generalist.ReinforceGeneralist, generalist.reinforce),
    },
}
"""A command, or several under one name."""
_ABOUT = {
    "dataset": "Record demonstrations to learn from, and use them",
    "generalist": "Train networks of the agent generalist",
}
"""What several commands under one name are for."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command line; exits 0 when done, 2 on wrong input, 130 when interrupted."""
    open_closed_streams()
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
    name, *words = arguments or [""]
    if name not in _COMMANDS:
        _run_without_command(arguments)
        return
    command = _COMMANDS[name]
    if isinstance(command, dict):
        if not words or words[0] not in command:
            _run_without_one_of(name, command, words)
            return
        name, command, words = f"{name} {words[0]}", command[words[0]], words[1:]
    _run_command(*command, f"cadenza {name}", words)


def _run_command(kind: type, run: Callable[..., None], prog: str, words: list[str]) -> None:
    if any(":" in word for word in words) and "" not in sys.path:
        sys.path.append("")  # `module:Name` of an agent or a hand may lie in the working folder
    chosen = choose(kind, prog, words)
    _import_parts(chosen)
    read: list[Callable[..., Any]] = []
    if issubclass(kind, Options):
        read = [reader(kind, prog, words, chosen)]
        command = read[0]()
    else:
        default = train.default(chosen) if kind is train.Train else None
        command = parse(kind, prog, words, default, chosen)
    with warnings_in_a_line(), quietly(getattr(command, "quiet", False)):
        run(command, *read)


def _import_parts(chosen: Chosen) -> None:
    """Imports the hand, the keyboard and the learner of a command line; no file does.

    Raises:
        CadenzaError: there is no such thing.
    """
    if chosen.hand is not None:
        from cadenza.hands.registry import hand_named

        hand_named(chosen.hand)
    if chosen.keyboard is not None:
        from cadenza.keyboards.registry import keyboard_named

        keyboard_named(chosen.keyboard)
    if chosen.learner is not None and module_of(chosen.learner) is not None:
        LEARNERS.load(chosen.learner, type)


def _run_without_command(arguments: list[str]) -> None:
    match arguments:
        case ["--version"]:
            from importlib.metadata import version

            print(f"cadenza {version('cadenza')}")
        case ["-h" | "--help" | "--help-all", *_]:
            _help_or_completion(["--help"])
        case ["--completion", shell] if shell in get_args(Shell):
            _help_or_completion(arguments)
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


def _help_or_completion(arguments: list[str]) -> None:
    help_or_completion(
        _kinds(_COMMANDS),
        _ABOUT,
        "cadenza",
        "Two simulated robot hands play the piano from any MIDI file.\n\n"
        'Run "cadenza COMMAND --help" for the options of a command.',
        arguments,
    )


def _kinds(commands: Mapping[str, Any]) -> dict[str, Any]:
    """Returns name -> the dataclass of a command with all its options, or such a mapping."""
    return {
        name: _kinds(command) if isinstance(command, dict) else _with_all_options(command[0])
        for name, command in commands.items()
    }


def _with_all_options(kind: type) -> type:
    return with_options_of_agents(kind) if issubclass(kind, Options) else kind


def _exit(status: int, message: str = "") -> NoReturn:
    """Prints why, and exits; drops output that cannot be written, of which Python complains."""
    with suppress(OSError):
        if message:
            print(f"cadenza: {on_one_line(message)}", file=sys.stderr)
    for stream in sys.stdout, sys.stderr:
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(status)
