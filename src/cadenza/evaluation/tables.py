"""What the runs of a bench say, as CSV and as JSON: the same figures as on the pages."""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from cadenza.evaluation.results import Result
from cadenza.files import write_atomically, write_json
from cadenza.report.overview import FIGURES, THRESHOLDS, Estimate, Overview

FORMAT = 1
_OF_FINGERS = ("return", "reward/fingering")
Row = Mapping[str, Any]


def write_tables(folder: Path, overview: Overview, results: Sequence[Result]) -> list[str]:
    """Writes agents.csv, pieces.csv, runs.csv and results.json; gives their names."""
    tables = {
        "agents": list(_agents(overview)),
        "pieces": list(_pieces(overview)),
        "runs": list(_runs(overview, results, folder)),
    }
    for name, rows in tables.items():
        _write_csv(folder / f"{name}.csv", rows)
    content = {
        "format": FORMAT,
        "title": overview.title,
        "figures": {name: figure.title for name, figure in FIGURES.items()},
        **tables,
        "profiles": list(_profiles(overview)),
        "remarks": [{"what": what, "cases": list(cases)} for what, cases in overview.remarks],
    }
    write_json(folder / "results.json", content)
    return [*(f"{name}.csv" for name in tables), "results.json"]


def _agents(overview: Overview) -> Iterator[Row]:
    """Of every group and agent: each figure's mean and interquartile mean."""
    for group in overview.groups:
        for agent, standing in group.standings.items():
            row: dict[str, Any] = {"group": group.name, "agent": agent}
            row |= {
                name: getattr(standing, name) for name in ("pieces", "runs", "repeated", "same")
            }
            for name in FIGURES:
                row |= _ends(f"{name}_mean", standing.mean[name])
                row |= _ends(f"{name}_iqm", standing.iqm[name])
            yield row


def _pieces(overview: Overview) -> Iterator[Row]:
    """Of every piece and agent: each figure's mean over seeds."""
    runs: dict[tuple[int, str], int] = {}
    for run in overview.runs:
        runs[run.piece, run.agent] = runs.get((run.piece, run.agent), 0) + 1
    for i, piece in enumerate(overview.pieces):
        about = {**vars(piece), "piece": piece.name}
        for j, agent in enumerate(overview.agents):
            if (i, agent) in runs:
                row = {name: about[name] for name in ("piece", "title", "composer", "library")}
                row |= {name: about[name] for name in ("difficulty", "seconds", "notes")}
                row |= {"agent": agent, "runs": runs[i, agent]}
                for name in FIGURES:
                    row |= _ends(name, Estimate(*(p[j, i] for p in overview.of_pieces[name])))
                yield row


def _runs(overview: Overview, results: Sequence[Result], folder: Path) -> Iterator[Row]:
    """Of every run its figures, and all else that was measured."""
    measured = list(dict.fromkeys(name for result in results for name in result.metrics))
    for run, result in zip(overview.runs, results, strict=True):
        row = {"piece": overview.pieces[run.piece].name, "agent": run.agent, "seed": run.seed}
        row |= {name: run.figures[name] for name in FIGURES}
        row |= {
            _column(name, result): result.metrics.get(name)
            for name in measured
            if name not in FIGURES
        }
        row |= vars(result.timing)
        row |= {f"{name}_version": version for name, version in result.versions.items()}
        yield row | {"folder": Path(os.path.relpath(result.folder, folder)).as_posix()}


def _column(name: str, result: Result) -> str:
    """Where a metric stands: the reward for other fingers is another figure."""
    fingers = result.metrics.get("rewarded_fingers")
    return f"{name}, fingers: {fingers}" if name in _OF_FINGERS and fingers else name


def _profiles(overview: Overview) -> Iterator[Row]:
    for group in overview.groups:
        for agent, standing in group.standings.items():
            for name, profile in standing.profile.items():
                about = {"group": group.name, "agent": agent, "figure": name}
                shares = {end: v.tolist() for end, v in profile._asdict().items()}
                yield about | {"above": THRESHOLDS.tolist(), **shares}


def _ends(name: str, estimate: Estimate) -> dict[str, float]:
    value, low, high = map(float, estimate)
    return {name: value, f"{name}_low": low, f"{name}_high": high}


def _write_csv(path: Path, rows: Sequence[Row]) -> None:
    text = io.StringIO(newline="")
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    with write_atomically(path) as file:
        file.write(text.getvalue().encode("utf-8", "replace"))


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
