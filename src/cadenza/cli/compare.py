"""`cadenza compare`: several agents play the same song."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

from cadenza.agents.registry import PLAYBACK
from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.console import in_columns
from cadenza.cli.options import Performing, Read, setting_up
from cadenza.cli.progress import stages
from cadenza.cli.saving import check_writable, default_folder
from cadenza.errors import CadenzaError
from cadenza.files import write_json

if TYPE_CHECKING:
    from cadenza.performing.setup import Selection
    from cadenza.report.comparison_page import Run


@dataclass(frozen=True)
class Compare(Performing):
    """Compare agents on one song, in a table and on a page.

    Example: cadenza compare OdeToJoy --agents planner predictive-sampling --seeds 0 1 2
    """

    agents: tuple[str, ...] = ("planner", "predictive-sampling")
    """Agents to compare, named as in "cadenza play". All but playback."""
    seeds: tuple[int, ...] = (0,)
    """Random seeds. Each agent plays once with each seed."""
    output: Output[Path | None] = None
    """Folder for compare.html and compare.json; played/SONG by default."""
    quiet: Quiet = False


def compare(command: Compare, read: Read[Compare]) -> None:
    from cadenza.performing.setup import select
    from cadenza.performing.source import resolve

    if not command.agents or not command.seeds:
        raise CadenzaError("nothing to compare: name at least one agent and one seed")
    if PLAYBACK in command.agents:
        raise CadenzaError(f"{PLAYBACK} plays a single file: name other agents")
    source = resolve(command.song, command.arrangement)
    selections = {name: select(source, name, configs=command.configs) for name in command.agents}
    commands = {
        name: read(task=selection.task, scene=selection.scene)
        for name, selection in selections.items()
    }
    for name, selection in selections.items():
        with setting_up(selection, commands[name]):
            pass  # what cannot be played is an error before any plays
    folder = command.output or default_folder(selections[command.agents[0]])
    check_writable(folder)
    remarks = [
        f"{name} plays with {differing}, as it was trained"
        for name, own in commands.items()
        if (differing := _differing(own, command))
    ]
    runs: list[Run] = []
    try:
        for name, seed in product(selections, dict.fromkeys(command.seeds)):
            runs.append(_run(name, selections[name], commands[name], seed))
    finally:  # also of what was stopped, or has failed
        if runs:
            _write(folder, runs, remarks, command)


def _write(folder: Path, runs: list[Run], remarks: list[str], command: Compare) -> None:
    """Writes the files, and prints the table."""
    from cadenza.report.comparison_page import comparison_page, means
    from cadenza.report.html_pages import write_page

    content = {
        "means": means(runs),
        "runs": [{"agent": run.agent, "seed": run.seed, **run.metrics} for run in runs],
        "settings": asdict(command),
        "remarks": remarks,
    }
    write_json(folder / "compare.json", content)
    write_page(folder / "compare.html", comparison_page(runs, remarks))
    print("\n".join([in_text(runs), *remarks]))
    print(f"\nOpen {folder / 'compare.html'}")


def _run(name: str, selection: Selection, command: Compare, seed: int) -> Run:
    from cadenza.performing.performance import perform
    from cadenza.report.comparison_page import Run, compared

    with setting_up(selection, command, seed) as setup, stages(f"{name}, seed {seed}") as progress:
        performance = perform(setup, progress)
    figures = compared(performance.metrics, performance.seconds)
    return Run(name, seed, figures, performance.episode)


def in_text(runs: Sequence[Run]) -> str:
    """Returns the table of means as text."""
    from cadenza.report.comparison_page import COLUMNS, means, metric_text

    rows = [["", *(title for title, _ in COLUMNS.values())]]
    for agent, metrics in means(runs).items():
        rows.append([agent, *(metric_text(name, metrics[name]) for name in COLUMNS)])
    return in_columns(rows)


def _differing(own: Compare, command: Compare) -> str:
    """Returns the options of task and scene that an agent has otherwise than the command."""
    from cadenza.tasks.config import task_identity

    options, others = (task_identity(each.task, each.scene, seed=0) for each in (own, command))
    changed = {name: v for name, v in options.items() if v != others[name]}
    return ", ".join(f"{name} {v} instead of {others[name]}" for name, v in changed.items())
