"""The command line: a module for each command, or for two that belong together.

Functions import heavy modules when they need them, so that --help is quick.
"""

import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import TextIOWrapper
from typing import Any, NoReturn

from cadenza.agents.registry import PLANNER
from cadenza.cli import (
    arrange,
    bench,
    benchmark,
    clone,
    dataset,
    etude,
    film,
    generalist,
    hand,
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
from cadenza.cli.arguments import Chosen, choose, parse, print_commands
from cadenza.cli.options import Options, reader, with_options_of
from cadenza.cli.printing import open_closed_streams, quietly, warnings_in_a_line
from cadenza.errors import explained, is_for_users, on_one_line
from cadenza.learning.learner import LEARNERS
from cadenza.registry import module_of

COMMANDS: dict[str, tuple[type, Callable[..., None]]] = {
    "play": (play.PlayCommand, play.run),
    "plan": (plan.PlanCommand, plan.run),
    "film": (film.Film, film.run),
    "arrange": (arrange.Arrange, arrange.run),
    "studio": (studio.StudioCommand, studio.run),
    "practice": (practice.PracticeCommand, practice.run),
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
    "hand measure": (hand.MeasureHand, hand.measure),
    "dataset collect": (dataset.Collect, dataset.collect),
    "dataset info": (dataset.DatasetInfo, dataset.info),
    "dataset play": (dataset.DatasetPlay, dataset.play),
    "dataset export": (dataset.DatasetExport, dataset.export),
    "generalist clone": (generalist.CloneGeneralist, generalist.clone),
    "generalist reinforce": (generalist.ReinforceGeneralist, generalist.reinforce),
    "generalist strike": (generalist.StrikeGeneralist, generalist.strike),
}
"""Name -> the options of a command, and what runs it."""
GROUPS = {
    "dataset": "Record demonstrations to learn from, and use them.",
    "generalist": "Train networks of the agent generalist.",
    "hand": "Bring a hand of your own.",
}
"""First word of several commands' names -> their purpose."""
_DEFAULTS: dict[type, Callable[[Chosen], Any]] = {
    train.Train: train.default,
    arrange.Arrange: arrange.default,
}
"""Commands whose defaults depend on `--setup` or `--learner` -> function to their defaults."""
_ABOUT = """Two simulated robot hands play the piano from any MIDI file.

Run "cadenza COMMAND --help" for the options of a command, the most common ones first, and
"cadenza --version" for the version."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line.

    Exits with 0 when done, 1 when something is wrong, 2 when the command line cannot be read, and
    130 when interrupted.
    """
    open_closed_streams()
    if isinstance(sys.stdout, TextIOWrapper):  # as stderr: names of files need not be text
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        try:
            _run(sys.argv[1:] if arguments is None else list(arguments))
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has left, as `head` does
        _exit(1)
    except Exception as error:
        if not is_for_users(error):
            raise
        _exit(1, explained(error))
    except KeyboardInterrupt:
        _exit(130, "interrupted")


def _run(words: list[str]) -> None:
    if words == ["--version"]:
        from importlib.metadata import version

        print(f"cadenza {version('cadenza')}")
        return
    count = 2 if words and words[0] in GROUPS else 1
    name, rest = " ".join(words[:count]), words[count:]
    if name not in COMMANDS:
        kinds = {
            name: with_options_of(kind, [PLANNER]) if issubclass(kind, Options) else kind
            for name, (kind, _) in COMMANDS.items()
        }
        print_commands(kinds, GROUPS, "cadenza", _ABOUT, words)
    kind, run = COMMANDS[name]
    if any(":" in word for word in words) and "" not in sys.path:
        sys.path.append("")  # `module:Name` of an agent or a hand may lie in the working folder
    prog = f"cadenza {name}"
    chosen = choose(prog, rest)
    _import_parts(chosen)
    read: list[Callable[..., Any]] = []
    if issubclass(kind, Options):
        read = [reader(kind, prog, rest, chosen)]
        command = read[0]()
    else:
        default = _DEFAULTS.get(kind, lambda _: None)(chosen)
        command = parse(kind, prog, rest, default)
    verbose = getattr(command, "verbose", True)
    with warnings_in_a_line(verbose), quietly(getattr(command, "quiet", False)):
        run(command, *read)


def _import_parts(chosen: Chosen) -> None:
    """Import the hand, the keyboard and the learner that a command line names.

    Raises CadenzaError if there is no such thing.
    """
    if chosen.hand is not None:
        from cadenza.hands.registry import hand_named

        hand_named(chosen.hand)
    if chosen.keyboard is not None:
        from cadenza.keyboards.registry import keyboard_named

        keyboard_named(chosen.keyboard)
    if chosen.learner is not None and module_of(chosen.learner) is not None:
        LEARNERS.load(chosen.learner, type)


def _exit(status: int, message: str = "") -> NoReturn:
    """Print a message, and exit; drop output that cannot be written."""
    with suppress(OSError):
        if message:
            print(f"cadenza: {on_one_line(message)}", file=sys.stderr)
    for stream in sys.stdout, sys.stderr:
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    sys.exit(status)
