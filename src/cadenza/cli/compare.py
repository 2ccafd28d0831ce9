"""`cadenza compare`: several agents play the same song."""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, field
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.agents.registry import PLAYBACK
from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.options import LEARNER, SONG, Options, Read, setting_up
from cadenza.cli.progress import stages
from cadenza.cli.saving import check_writable, default_folder
from cadenza.errors import CadenzaError
from cadenza.files import folder_name, write_json

if TYPE_CHECKING:
    from cadenza.music.score import Score
    from cadenza.performing.loaded_song import LoadedSong
    from cadenza.performing.player import Player
    from cadenza.report.bench_summary import RunSummary


@dataclass(frozen=True)
class Compare(Options):
    """Compare agents on one song, in a table and on a page.

    Example: cadenza compare OdeToJoy --agents planner predictive-sampling --seeds 0 1 2
    """

    song: Annotated[tyro.conf.Positional[str], SONG] = field(kw_only=True)
    agents: tuple[str, ...] = ("planner", "predictive-sampling")
    """Agents to compare, named as in "cadenza play". All but playback."""
    seeds: tuple[int, ...] = (0,)
    """Random seeds. Each agent plays once with each seed."""
    output: Output[Path | None] = None
    """Folder for compare.html, compare.json and a folder of each run; played/SONG by default."""
    learner: Annotated[str | None, LEARNER] = None
    quiet: Quiet = False


def compare(command: Compare, read: Read[Compare]) -> None:
    from cadenza.performing.loaded_song import load
    from cadenza.performing.player import find_player

    if not command.agents or not command.seeds:
        raise CadenzaError("nothing to compare: name at least one agent and one seed")
    if PLAYBACK in command.agents:
        raise CadenzaError(f"{PLAYBACK} plays a single file: name other agents")
    song = load(command.song, command.arrangement)
    players = {
        name: find_player(name, song.name, configs=command.configs) for name in command.agents
    }
    commands = {
        name: read(task=player.task, scene=player.scene) for name, player in players.items()
    }
    for name, player in players.items():  # what cannot be played is an error before any plays
        with setting_up(commands[name], song, player, 0) as setup:
            folder = command.output or default_folder(setup)
    check_writable(folder)
    remarks = [
        f"{name} plays with {differing}, as it was trained"
        for name, own in commands.items()
        if (differing := _differing(own, command))
    ]
    runs: list[RunSummary] = []
    try:
        for name, seed in product(players, dict.fromkeys(command.seeds)):
            runs.append(_run(commands[name], song, players[name], seed, folder))
    finally:  # also of what was stopped, or has failed
        if runs:
            _write(folder, song.score, runs, remarks, command)


def _run(command: Compare, song: LoadedSong, player: Player, seed: int, folder: Path) -> RunSummary:
    """Play once, and leave the performance in a folder of its own."""
    from cadenza.evaluation.results import PAGE, Timing
    from cadenza.evaluation.summary import run_metrics
    from cadenza.performing.performance import check_replaceable, perform
    from cadenza.report.bench_summary import RunSummary

    own = folder / folder_name(f"{player.name}--s{seed}")
    check_replaceable(own)
    began, cpu_before = time.perf_counter(), time.process_time()
    with stages(f"{player.name}, seed {seed}") as progress:
        with setting_up(command, song, player, seed) as setup:
            performance = perform(setup, progress)
        timing = Timing(
            wall_seconds=time.perf_counter() - began,
            music_seconds=performance.seconds,
            threads=setup.agent.threads,
            cpu_seconds=time.process_time() - cpu_before,
        )
        performance.save(own, progress)
    return RunSummary(0, player.name, seed, run_metrics(performance.metrics, timing), own / PAGE)


def _write(
    folder: Path, score: Score, runs: list[RunSummary], remarks: list[str], command: Compare
) -> None:
    """Write the files, and print the table."""
    from cadenza.cli.results import in_text
    from cadenza.evaluation.summary import summary_of
    from cadenza.report.bench_summary import PieceSummary
    from cadenza.report.html_pages import write_page
    from cadenza.report.summary_page import summary_page

    title = score.title or "Untitled"
    piece = PieceSummary(command.song, title, "", "", math.nan, score.total_time, len(score.notes))
    summary = summary_of(title, [piece], runs, [(remark, ()) for remark in remarks])
    (group,) = summary.groups
    content = {
        "means": {
            agent: {name: mean.value for name, mean in own.mean.items()}
            for agent, own in group.agents.items()
        },
        "runs": [{"agent": run.agent, "seed": run.seed, **run.metrics} for run in runs],
        "settings": asdict(command),
        "remarks": remarks,
    }
    write_json(folder / "compare.json", content)
    write_page(folder / "compare.html", summary_page(summary, folder))
    print("\n".join([in_text(summary), *remarks]))
    print(f"\nOpen {folder / 'compare.html'}")


def _differing(own: Compare, command: Compare) -> str:
    """Return the options of task and scene that an agent has otherwise than the command."""
    from cadenza.tasks.config import task_identity

    options, others = (task_identity(each.task, each.scene, seed=0) for each in (own, command))
    changed = {name: v for name, v in options.items() if v != others[name]}
    return ", ".join(f"{name} {v} instead of {others[name]}" for name, v in changed.items())
