"""The command line: a module for each command, or for two that belong together.

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
    arrange,
    bench,
    benchmark,
    clone,
    compare,
    dataset,
    etude,
    film,
    generalist,
    importing,
    info,
    plan,
    play,
    practice,
    publish,
    results,
    songs,
    studio,
    train,
)
from cadenza.cli.arguments import Chosen, Shell, choose, parse, print_commands, similar
from cadenza.cli.console import open_closed_streams, quietly, warnings_in_a_line
from cadenza.cli.options import Options, reader, with_options_of_agents
from cadenza.errors import CadenzaError, explained, is_for_users, on_one_line
from cadenza.learning.learner import LEARNERS
from cadenza.registry import module_of

_COMMANDS: dict[str, Any] = {
    "play": (play.PlayCommand, play.run),
    "plan": (plan.PlanCommand, plan.run),
    "film": (film.Film, film.run),
    "arrange": (arrange.Arrange, arrange.run),
    "studio": (studio.StudioCommand, studio.run),
    "practice": (practice.PracticeCommand, practice.run),
    "compare": (compare.Compare, compare.compare),
    "bench": (bench.Bench, bench.run),
    "results": (results.Results, results.results),
    "benchmark": (benchmark.Benchmark, benchmark.benchmark),
    "enter": (benchmark.Enter, benchmark.enter),
    "verify": (benchmark.Verify, benchmark.verify),
    "leaderboard": (benchmark.Leaderboard, benchmark.leaderboard),
    "train": (train.Train, train.train),
    "clone": (clone.Clone, clone.clone),
    "publish": (publish.Publish, publish.run),
    "curves": (train.Curves, train.curves),
    "songs": (songs.Songs, songs.songs),
    "libraries": (songs.Libraries, songs.libraries),
    "import": (importing.Import, importing.run),
    "info": (info.Info, info.info),
    "etude": (etude.Etude, etude.etude),
    "dataset": (
        "Record demonstrations to learn from, and use them",
        {
            "collect": (dataset.Collect, dataset.collect),
            "info": (dataset.DatasetInfo, dataset.info),
            "check": (dataset.DatasetCheck, dataset.check),
            "play": (dataset.DatasetPlay, dataset.play),
            "export": (dataset.DatasetExport, dataset.export),
        },
    ),
    "generalist": (
        "Train networks of the agent generalist",
        {
            "clone": (generalist.CloneGeneralist, generalist.clone),
            "reinforce": (generalist.ReinforceGeneralist, generalist.reinforce),
            "strike": (generalist.StrikeGeneralist, generalist.strike),
        },
    ),
}
"""Name -> the options of a command and what runs it; or what several are for, and those."""
_DEFAULTS: dict[type, Callable[[Chosen], Any]] = {
    train.Train: train.default,
    arrange.Arrange: arrange.default,
}
"""Commands whose options have other defaults with `--setup` or `--learner` -> those."""
_ABOUT = "Two simulated robot hands play the piano from any MIDI file."


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
    except Exception as error:
        if not is_for_users(error):
            raise
        _exit(2, explained(error))
    except KeyboardInterrupt:
        _exit(130, "interrupted")


def _run(
    words: list[str],
    commands: Mapping[str, Any] = _COMMANDS,
    prog: str = "cadenza",
    about: str = _ABOUT,
) -> None:
    name, *others = words or [""]
    match commands.get(name):
        case (str(what), several):
            _run(others, several, f"{prog} {name}", f"{what}.")
        case (kind, run):
            _run_command(kind, run, f"{prog} {name}", others)
        case None:
            _run_without_command(words, commands, prog, about)


def _run_command(kind: type, run: Callable[..., None], prog: str, words: list[str]) -> None:
    if any(":" in word for word in words) and "" not in sys.path:
        sys.path.append("")  # `module:Name` of an agent or a hand may lie in the working folder
    chosen = choose(prog, words)
    _import_parts(chosen)
    read: list[Callable[..., Any]] = []
    if issubclass(kind, Options):
        read = [reader(kind, prog, words, chosen)]
        command = read[0]()
    else:
        default = _DEFAULTS.get(kind, lambda _: None)(chosen)
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


def _run_without_command(
    words: list[str], commands: Mapping[str, Any], prog: str, about: str
) -> None:
    about += f'\n\nRun "{prog} COMMAND --help" for the options of a command.'
    match words:
        case ["--version"]:
            from importlib.metadata import version

            print(f"cadenza {version('cadenza')}")
        case ["-h" | "--help" | "--help-all", *_]:
            print_commands(_kinds(commands), prog, about)
        case ["--completion", "bash" | "zsh" | "fish" as shell]:
            print_commands(_kinds(commands), prog, about, shell)
        case ["--completion", *_]:
            raise CadenzaError(f"--completion: choose from {', '.join(get_args(Shell))}")
        case []:
            raise CadenzaError(f"name a command: {', '.join(commands)}; see {prog} --help")
        case [word, *_]:
            what = "option" if word.startswith("-") else "command"
            meant = similar(word, [*commands, "--help", "--version", "--completion"])
            raise CadenzaError(f"there is no {what} {word}{meant or f'; see {prog} --help'}")


def _kinds(commands: Mapping[str, Any]) -> dict[str, Any]:
    """Returns name -> the dataclass of a command with all its options, as `print_commands` asks."""
    kinds: dict[str, Any] = {}
    for name, (kind, command) in commands.items():
        if isinstance(kind, str):
            kinds[name] = kind, _kinds(command)
        else:
            kinds[name] = with_options_of_agents(kind) if issubclass(kind, Options) else kind
    return kinds


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
