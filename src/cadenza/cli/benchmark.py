"""`cadenza benchmark`, `enter`, `verify` and `leaderboard`: a benchmark that others can enter."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.console import counted, in_columns
from cadenza.cli.progress import progress
from cadenza.cli.saving import check_writable
from cadenza.errors import CadenzaError, on_one_line
from cadenza.evaluation.benchmark.about import About

if TYPE_CHECKING:
    from cadenza.evaluation.benchmark.verification import Verified

_REFUSED = 1  # exit status, beside 2 for a command that makes no sense


@dataclass(frozen=True)
class Benchmark:
    """List the tracks and sets of the benchmark.

    Example: cadenza benchmark
    """


def benchmark(_command: Benchmark) -> None:
    from cadenza.evaluation.benchmark.definition import (
        MUJOCO,
        PAPER_SETS,
        PUBLIC_SETS,
        TRACKS,
        VERSION,
        frozen,
        open_set,
    )

    print(f"Benchmark, version {VERSION}: scene {frozen().scene}, MuJoCo {MUJOCO}\n\nTracks")
    print(in_columns([["", name, about] for name, about in TRACKS.items()], "<<<"))
    rows = [["", name, counted(len(open_set(name).songs), "song"), ""] for name in PUBLIC_SETS]
    for name, number in PAPER_SETS.items():
        rows.append(["", name, counted(number, "song"), "to be imported"])
    rows.append(["", "yours", "", "LIBRARY or LIBRARY:SPLIT that you imported"])
    print(f"\nSets, as --songs of cadenza bench takes them\n{in_columns(rows, '<<<<')}")


@dataclass(frozen=True, kw_only=True)
class Enter(About):
    """Make an entry to the benchmark of the runs of "cadenza bench".

    Example: cadenza enter bench --songs bundled --track planning -o entry
    """

    bench: tyro.conf.Positional[Path]
    """Folder of the bench."""
    output: Output[Path] = Path("entry")
    """A new folder for the entry."""
    quiet: Quiet = False


def enter(command: Enter) -> None:
    from cadenza.evaluation.benchmark.entry import enter as write_entry

    with progress("playing again", "runs") as advance:
        verified = write_entry(command.bench, command.output, command, advance)
    print(f"{command.output}: {_in_words(verified)}")


@dataclass(frozen=True)
class Verify:
    """Play an entry to the benchmark again, and compute its metrics anew.

    Exits with status 1 if it differs from what it claims.

    Example: cadenza verify entry
    """

    entry: tyro.conf.Positional[Path]
    """Folder of the entry, or hub:OWNER/NAME."""
    quiet: Quiet = False


def verify(command: Verify) -> None:
    from cadenza.evaluation.benchmark.leaderboard import entries_in
    from cadenza.evaluation.benchmark.sharing import at_hand
    from cadenza.evaluation.benchmark.verification import verify as play_again

    with at_hand([command.entry]) as (entry,):
        if entry not in (found := entries_in([entry])):
            raise CadenzaError(f"{command.entry}: is no entry, but holds one: give {found[0]}")
        try:
            with progress("playing again", "runs") as advance:
                verified = play_again(entry, advance)
            problems = verified.problems
        except CadenzaError as error:
            problems = [str(error)]
    if problems:
        print(
            *(f"refused: {on_one_line(problem)}" for problem in problems),
            sep="\n",
            file=sys.stderr,
        )
        raise SystemExit(_REFUSED)
    print(f"{command.entry}: {_in_words(verified)}")


def _in_words(verified: Verified) -> str:
    """Returns a line on an entry that was played again."""
    from cadenza.evaluation.benchmark.leaderboard import figures

    found, card = figures(verified), verified.card
    return (
        f"{card.name} in {card.track} on {card.songs}, {counted(len(card.runs), 'run')}: "
        f"F1 {found['f1']:.3f}, note onset F1 {found['note_onset_f1']:.3f}; verified "
        f"{verified.words}"
    )


@dataclass(frozen=True)
class Leaderboard:
    """Verify entries, and make the table of them: a page, CSV and Markdown.

    Example: cadenza leaderboard entries -o leaderboard
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Entries, or folders of entries. An entry may be hub:OWNER/NAME."""
    output: Output[Path] = Path("leaderboard")
    """Folder for index.html, leaderboard.csv and leaderboard.md."""
    quiet: Quiet = False


def leaderboard(command: Leaderboard) -> None:
    from cadenza.evaluation.benchmark.leaderboard import entries_in, standing, write_leaderboard
    from cadenza.evaluation.benchmark.sharing import at_hand

    with at_hand(command.folders) as folders:
        entries = entries_in(folders)
        check_writable(command.output)
        standings = []
        with progress("verifying", "entries") as advance:
            for entry in entries:
                standings.append(standing(entry))
                advance(len(standings), len(entries))
    page, _, text = write_leaderboard(command.output, standings)
    print(text.read_text())
    print(f"Open {page}")
