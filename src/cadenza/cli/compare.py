"""`cadenza compare`: several agents play the same song."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.cli.performing import (
    WithOtherPlanners,
    agent_named,
    build_task,
    perform,
    score_of,
    seconds_of_music,
)
from cadenza.cli.results import check_writable, write_json
from cadenza.errors import CadenzaError
from cadenza.tasks.config import TaskConfig

if TYPE_CHECKING:
    from cadenza.agents.play import Performance


@dataclass(frozen=True)
class Compare(WithOtherPlanners):
    """Have several agents play the same song, and draw how they do.

    Example: cadenza compare OdeToJoy --agents planner predictive-sampling --seeds 0 1 2
    """

    agents: tuple[str, ...] = ("planner", "predictive-sampling")
    """Who plays, named as in "cadenza play", without replay."""
    seeds: tuple[int, ...] = (0,)
    """Each agent plays once with each."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for compare.html and compare.json; played/SONG by default."""


def compare(command: Compare) -> None:
    from cadenza.report.comparison import Run, in_text, means, write_comparison

    if not command.agents or not command.seeds:
        raise CadenzaError("nothing to compare: name at least one agent and one seed")
    score = score_of(command.song, command.arrangement)
    agents = {name: agent_named(name, command) for name in command.agents}
    task = build_task(score, command)
    folder = command.output or command.default_folder
    check_writable(folder)
    runs = []
    with closing(task):
        for (name, agent), seed in product(agents.items(), dict.fromkeys(command.seeds)):
            performance = perform(task, agent, seed, f"{name}, seed {seed}")
            figures = _figures(performance, command.task)
            runs.append(Run(name, seed, figures, performance.episode))
    content = {
        "means": means(runs),
        "runs": [{"agent": run.agent, "seed": run.seed, **run.figures} for run in runs],
        "settings": asdict(command),
    }
    write_json(folder / "compare.json", content)
    write_comparison(folder / "compare.html", runs)
    print(in_text(runs))
    print(f"\nOpen {folder / 'compare.html'}")


def _figures(performance: Performance, config: TaskConfig) -> dict[str, float]:
    """What is compared. The energy is that of all actuators, their power as of each step's end."""
    metrics = performance.metrics
    figures = {name: metrics[name] for name in ("f1", "precision", "recall", "note_onset_f1")}
    energy = math.nan
    if config.energy_coefficient and "reward/energy" in metrics:
        energy = -metrics["reward/energy"] / config.energy_coefficient * config.control_timestep
    error = metrics["timing_error"]
    return figures | {
        "timing_error": math.nan if error is None else error,
        "energy": energy,
        "planning": metrics["planning_seconds"] / seconds_of_music(performance),
    }
