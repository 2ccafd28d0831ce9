"""`cadenza benchmark`, `enter`, `verify` and `leaderboard`: a benchmark that others can enter."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.console import counted, in_columns, on_one_line
from cadenza.cli.progress import progress
from cadenza.cli.saving import check_writable
from cadenza.errors import CadenzaError

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


@dataclass(frozen=True)
class Enter:
    """Make an entry to the benchmark of the runs of "cadenza bench".

    Example: cadenza enter bench --songs bundled --track planning -o entry
    """

    bench: tyro.conf.Positional[Path]
    """Folder of the bench."""
    songs: str
    """Set whose songs were played, see "cadenza benchmark"."""
    track: Literal["one-song", "at-sight", "planning"]
    """What the agent may know, see "cadenza benchmark"."""
    output: Output[Path] = Path("entry")
    """A new folder for the entry."""
    agent: str | None = None
    """Agent of the bench. By default the only one that played these songs."""
    name: str = ""
    """Name of the row. By default that of the agent."""
    by: str = "anonymous"
    """Who enters it, and where its code is."""
    data: str = "nothing"
    """What it has learnt from."""
    hardware: str = ""
    """Processor, and GPU if one was used. By default this processor."""
    training_steps: int | None = None
    """Control steps of training or practice, for all songs together. Known of train:PRESET."""
    cpu_hours: float | None = None
    """Core hours of training or practice. Known of train:PRESET."""
    gpu_hours: float | None = None
    """Hours of a GPU."""
    quiet: Quiet = False


def enter(command: Enter) -> None:
    from cadenza.evaluation.benchmark.card import Effort
    from cadenza.evaluation.benchmark.entry import About
    from cadenza.evaluation.benchmark.entry import enter as write_entry

    about = About(
        track=command.track,
        songs=command.songs,
        agent=command.agent,
        name=command.name,
        by=command.by,
        data=command.data,
        hardware=command.hardware or _processor(),
        effort=Effort(command.training_steps, command.cpu_hours, command.gpu_hours),
    )
    with progress("playing again", "runs") as advance:
        verified = write_entry(command.bench, command.output, about, advance)
    print(f"{command.output}: {_in_words(verified)}")


def _processor() -> str:
    """Returns the name of the processor, as Linux says it."""
    import platform

    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.machine()


@dataclass(frozen=True)
class Verify:
    """Play an entry to the benchmark again, and compute its metrics anew.

    Exits with status 1 if it differs from what it claims.

    Example: cadenza verify entry
    """

    entry: tyro.conf.Positional[Path]
    """Folder of the entry."""
    quiet: Quiet = False


def verify(command: Verify) -> None:
    from cadenza.evaluation.benchmark.leaderboard import entries_in
    from cadenza.evaluation.benchmark.verification import verify as play_again

    if command.entry not in (found := entries_in([command.entry])):
        raise CadenzaError(f"{command.entry}: is no entry, but holds one: give {found[0]}")
    try:
        with progress("playing again", "runs") as advance:
            verified = play_again(command.entry, advance)
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
    """Entries, or folders of entries."""
    output: Output[Path] = Path("leaderboard")
    """Folder for index.html, leaderboard.csv and leaderboard.md."""
    quiet: Quiet = False


def leaderboard(command: Leaderboard) -> None:
    from cadenza.evaluation.benchmark.leaderboard import entries_in, standing, write_leaderboard

    entries = entries_in(command.folders)
    check_writable(command.output)
    standings = []
    with progress("verifying", "entries") as advance:
        for entry in entries:
            standings.append(standing(entry))
            advance(len(standings), len(entries))
    page, _, text = write_leaderboard(command.output, standings)
    print(text.read_text())
    print(f"Open {page}")
