"""`cadenza benchmark`, `enter`, `verify` and `leaderboard`: a benchmark that others can enter."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.printing import in_columns, progress
from cadenza.cli.saving import check_writable
from cadenza.errors import counted

if TYPE_CHECKING:
    from cadenza.evaluation.benchmark.verification import PlayedAgain

_NOT_VERIFIED = 1  # exit status, as of an entry that is refused


@dataclass(frozen=True)
class Benchmark:
    """List the tracks and sets of the benchmark.

    Example: cadenza benchmark
    """


def benchmark(_command: Benchmark) -> None:
    from cadenza.evaluation.benchmark.definition import (
        DEPLOYMENT,
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
    rows = [
        ["", name, counted(len(open_set(name).songs), "song"), ""]
        for name in (*PUBLIC_SETS, DEPLOYMENT)
    ]
    for name, number in PAPER_SETS.items():
        rows.append(["", name, counted(number, "song"), "to be imported"])
    rows.append(["", "yours", "", "LIBRARY or LIBRARY:SPLIT that you imported"])
    print(f"\nSets, as --songs of cadenza bench takes them\n{in_columns(rows, '<<<<')}")


@dataclass(frozen=True, kw_only=True)
class Enter:
    """Make an entry to the benchmark of the runs of "cadenza bench".

    Example: cadenza enter bench --songs bundled --track planning --about "learnt from nothing"
    """

    bench: tyro.conf.Positional[Path]
    """Folder of the bench; of the track deployment, of what "cadenza practice --robot" wrote."""
    songs: str
    """Set whose songs were played, see "cadenza benchmark"."""
    track: Literal["one-song", "at-sight", "planning", "deployment"]
    """What the agent may know, see "cadenza benchmark"."""
    about: str
    """What it has learnt from, for how many steps, and where its code is."""
    by: str = "anonymous"
    """Who enters it."""
    agent: str | None = None
    """Agent of the bench. By default the only one that played these songs."""
    name: str | None = None
    """Name of the row. By default that of the agent."""
    output: Output[Path] = Path("entry")
    """A new folder for the entry."""
    quiet: Quiet = False


def enter(command: Enter) -> None:
    from cadenza.evaluation.benchmark.entering import enter as write_entry

    with progress("playing again", "runs") as advance:
        played = write_entry(
            command.bench,
            command.output,
            songs=command.songs,
            track=command.track,
            about=command.about,
            by=command.by,
            agent=command.agent,
            name=command.name,
            progress=advance,
        )
    print(f"{command.output}: verified, {_in_words(played)}")


@dataclass(frozen=True)
class Verify:
    """Play an entry to the benchmark again, and compute its metrics anew.

    Exits with status 1 if one of them is not what the entry claims, to the bit.

    Example: cadenza verify entry
    """

    entry: tyro.conf.Positional[Path]
    """Folder of the entry."""
    quiet: Quiet = False


def verify(command: Verify) -> None:
    from cadenza.evaluation.benchmark.verification import verify as play_again

    with progress("playing again", "runs") as advance:
        played = play_again(command.entry, advance)
    for difference in played.differences:
        print(f"unverified: {difference}", file=sys.stderr)
    status = "unverified" if played.differences else "verified"
    print(f"{command.entry}: {status}, {_in_words(played)}")
    if played.differences:
        raise SystemExit(_NOT_VERIFIED)


def _in_words(played: PlayedAgain) -> str:
    """The entry that was played again, and its result."""
    from cadenza.evaluation.benchmark.leaderboard import means

    metrics, entry = means(played), played.entry
    return (
        f"{entry.name} in {entry.track} on {entry.songs}, {counted(len(entry.runs), 'run')}: "
        f"note onset F1 {metrics['note_onset_f1']:.3f}, F1 {metrics['f1']:.3f}"
    )


@dataclass(frozen=True)
class Leaderboard:
    """Verify entries, and make the table of them as CSV and in Markdown.

    Example: cadenza leaderboard entries -o leaderboard
    """

    folders: tyro.conf.Positional[tuple[Path, ...]]
    """Entries, or folders of entries."""
    output: Output[Path] = Path("leaderboard")
    """Folder for leaderboard.csv and leaderboard.md."""
    quiet: Quiet = False


def leaderboard(command: Leaderboard) -> None:
    from cadenza.evaluation.benchmark.leaderboard import entries_in, row_of, write_leaderboard

    entries = entries_in(command.folders)
    check_writable(command.output)
    rows = []
    with progress("verifying", "entries") as advance:
        for entry in entries:
            rows.append(row_of(entry))
            advance(len(rows), len(entries))
    table, text = write_leaderboard(command.output, rows)
    print(text.read_text())
    print(f"Wrote {table} and {text}")
