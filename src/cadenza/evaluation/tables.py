"""The CSV files that sum up many runs: agents, pieces and runs."""

import csv
import io
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cadenza.evaluation.results import Result
from cadenza.evaluation.summary import METRICS, BenchSummary, Estimate
from cadenza.files import write_atomically

_ABOUT_A_PIECE = ("piece", "title", "composer", "library", "difficulty", "seconds", "notes")
_FINGER_REWARDS = ("return", "reward/fingering")
Row = Mapping[str, Any]


def write_tables(folder: Path, summary: BenchSummary) -> list[str]:
    """Write agents.csv, pieces.csv, runs.csv and, of several agents, differences.csv.

    Returns their names.
    """
    tables = {
        "agents": list(_agents(summary)),
        "pieces": list(_pieces(summary)),
        "runs": list(_runs(summary, folder)),
    }
    if differences := list(_differences(summary)):
        tables["differences"] = differences
    for name, rows in tables.items():
        write_csv(folder / f"{name}.csv", rows)
    return [f"{name}.csv" for name in tables]


def _agents(summary: BenchSummary) -> Iterator[Row]:
    """Yield the mean of each metric for every group and agent."""
    for group in summary.groups:
        for agent, agent_summary in group.agents.items():
            row: dict[str, Any] = {"group": group.name, "agent": agent}
            row |= {"pieces": agent_summary.pieces, "runs": agent_summary.runs}
            for name in METRICS:
                row |= _ends(name, agent_summary.mean[name])
            yield row


def _differences(summary: BenchSummary) -> Iterator[Row]:
    """Yield how much each agent is better than the best one, for every group."""
    for group in summary.groups:
        for agent, of_agent in group.differences.items():
            row: dict[str, Any] = {"group": group.name, "agent": agent}
            row |= {"than": next(iter(group.agents))}
            for name, estimate in of_agent.items():
                row |= _ends(name, estimate)
            yield row


def _pieces(summary: BenchSummary) -> Iterator[Row]:
    """Yield the mean of each metric over the seeds for every piece and agent."""
    runs = Counter((run.piece, run.agent) for run in summary.runs)
    for i, piece in enumerate(summary.pieces):
        about = {**vars(piece), "piece": piece.name}
        for j, agent in enumerate(summary.agents):
            if (i, agent) in runs:
                row = {name: about[name] for name in _ABOUT_A_PIECE}
                row |= {"agent": agent, "runs": runs[i, agent]}
                for name in METRICS:
                    row |= _ends(name, Estimate(*(p[j, i] for p in summary.by_piece[name])))
                yield row


def _runs(summary: BenchSummary, folder: Path) -> Iterator[Row]:
    """Yield the metrics of every run, those of `METRICS` and all others."""
    names = list(dict.fromkeys(name for run in summary.runs for name in run.result.metrics))
    for run in summary.runs:
        result = run.result
        row = {"piece": summary.pieces[run.piece].name, "agent": run.agent, "seed": result.seed}
        row |= {name: run.metrics[name] for name in METRICS}
        row |= {
            _column(name, result): result.metrics.get(name) for name in names if name not in METRICS
        }
        row |= vars(result.timing)
        row |= {f"{name}_version": version for name, version in result.versions.items()}
        yield row | {"folder": Path(os.path.relpath(result.folder, folder)).as_posix()}


def _column(name: str, result: Result) -> str:
    """The column of a metric; a reward has one for each choice of rewarded fingers."""
    fingers = result.metrics.get("rewarded_fingers")
    return f"{name}, fingers: {fingers}" if name in _FINGER_REWARDS and fingers else name


def _ends(name: str, estimate: Estimate) -> dict[str, float]:
    value, low, high = map(float, estimate)
    return {name: value, f"{name}_low": low, f"{name}_high": high}


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as a CSV file, with a column for every name in any row."""
    text = io.StringIO(newline="")
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    with write_atomically(path) as file:
        file.write(text.getvalue().encode("utf-8", "replace"))


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
