"""The page that sums up many runs, its chart of all pieces as an SVG picture, and tables as CSV."""

import csv
import io
import math
import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from cadenza.errors import counted
from cadenza.evaluation.jobs import SongFacts
from cadenza.evaluation.results import PAGE, Result
from cadenza.evaluation.summary import METRICS, BenchSummary, Estimate, interval_text, metric_text
from cadenza.files import write_atomically
from cadenza.report.html_pages import render, write_page

_ABOUT = "Piece", "Library", "Difficulty", "Seconds", "Notes"  # columns of a table of pieces
_MAX_CASES = 12  # of a caveat that are shown
_MAX_SEEDS = 5  # that are named one by one

_WIDTH, _LEFT, _RIGHT = 1200, 48, 16  # [px]
_HEIGHT = 150  # [px] of a chart
_TITLE, _GAP = 34, 10  # [px] above a chart, and below it
_LINE = 24  # [px] height of the names below a chart
_MIN_NAMED_COLUMN = 13  # [px] a column has to be this wide for its name
_MAX_TITLE = 26  # characters of a name
_CHARACTER = 6.8  # [px] width of an average character
_BAR_SHARE, _MAX_BAR = 0.76, 44  # width of a bar, of its column and [px]
_MAX_CAP, _MAX_DOT = 5, 3  # [px] half the end of an interval, radius of a dot


def summary_page(
    summary: BenchSummary, folder: Path, downloads: Sequence[str] = ()
) -> Iterator[str]:
    """Yield the page of one run or more piece by piece, see `html_pages.render`.

    Addresses are relative to its folder, in which `downloads` are files.
    """
    seeds = sorted({run.result.seed for run in summary.runs})
    seconds = math.fsum(piece.seconds or 0.0 for piece in summary.pieces)
    several = len(summary.pieces) > 1
    return render(
        "summary.html",
        **_figure(summary),
        title=summary.title,
        facts={
            "pieces": str(len(summary.pieces)),
            "of music": f"{seconds / 60:.1f} min",
            "agents": str(len(summary.agents)),
            "seeds": ", ".join(map(str, seeds)) if len(seeds) <= _MAX_SEEDS else str(len(seeds)),
            "runs": str(len(summary.runs)),
        },
        caveats=summary.caveats,
        max_cases=_MAX_CASES,
        groups=summary.groups if several else [],
        about=_ABOUT if several else (),
        rows=_rows(summary, folder),
        metrics=METRICS,
        interval_text=interval_text,
        downloads=downloads,
        styles=("page.css", "summary.css"),
    )


def _rows(
    summary: BenchSummary, folder: Path
) -> Iterator[tuple[SongFacts, str, list[tuple[int, str | None]], dict[str, Estimate]]]:
    """Yield each piece and agent, the seeds and pages of its runs, and its means over them."""
    runs: dict[tuple[int, str], list[tuple[int, str | None]]] = {}
    for run in summary.runs:
        page = run.result.folder / PAGE
        shown = _address(page, folder) if page.exists() else None
        runs.setdefault((run.piece, run.agent), []).append((run.result.seed, shown))
    for i, piece in enumerate(summary.pieces):
        for j, agent in enumerate(summary.agents):
            if own := runs.get((i, agent)):
                by_piece = summary.by_piece.items()
                means = {name: Estimate(*(part[j, i] for part in each)) for name, each in by_piece}
                yield piece, agent, sorted(own), means


def _address(page: Path, folder: Path) -> str:
    return quote(os.fsencode(Path(os.path.relpath(page, folder)).as_posix()))


def write_figure(path: Path, summary: BenchSummary) -> None:
    """Draw the note onset F1 of all pieces with its intervals, a chart an agent, the best first.

    A dot is the F1. Of a single piece there is one chart with a bar an agent.
    """
    write_page(path, render("figure.svg", **_figure(summary)))


def _figure(summary: BenchSummary) -> dict[str, Any]:
    """Return what `figure.svg` draws: a chart for each row, and a bar in it for each column."""
    tables = [*summary.by_piece["note_onset_f1"], summary.by_piece["f1"].value]
    rows, columns = list(summary.agents), [piece.title for piece in summary.pieces]
    legends = [_means_text(summary, agent) for agent in rows]
    if len(columns) == 1:
        rows, columns, legends = columns, rows, ["note onset F1 (bars), F1 (dots)"]
        tables = [table.T for table in tables]
    order = np.argsort(-tables[0][0], kind="stable").tolist()  # what has none comes last
    chart_width = _WIDTH - _LEFT - _RIGHT
    column = chart_width / len(order)
    titles = (columns[i] for i in order if column >= _MIN_NAMED_COLUMN)
    names = [t if len(t) <= _MAX_TITLE else f"{t[: _MAX_TITLE - 1]}…" for t in titles]
    longest = _CHARACTER * max(map(len, names), default=0)
    is_turned = longest > column
    below = (_TITLE + _HEIGHT + _GAP) * len(rows)
    bar_width = min(_BAR_SHARE * column, _MAX_BAR)
    agents = ", ".join(summary.agents)
    return {
        "caption": f"Note onset F1 and F1 of {counted(len(summary.pieces), 'piece')} by {agents}",
        "width": _WIDTH,
        "height": below + _GAP + round(longest if is_turned else _LINE),
        "left": _LEFT,
        "chart_width": chart_width,
        "column": column,
        "bar_width": bar_width,
        "cap": min(bar_width / 4, _MAX_CAP),
        "dot": min(bar_width / 4, _MAX_DOT),
        "charts": [
            {
                "top": _TITLE + (_TITLE + _HEIGHT + _GAP) * n,
                "title": row,
                "legend": legend,
                "bars": [(columns[i], *(table[n][i] for table in tables)) for i in order],
            }
            for n, (row, legend) in enumerate(zip(rows, legends, strict=True))
        ],
        "names": names,
        "is_turned": is_turned,
        "below": below,
        "metric_text": metric_text,
        "y": lambda share: _HEIGHT * (1 - min(max(share, 0.0), 1.0)),
        "px": "{:.2f}".format,
    }


def _means_text(summary: BenchSummary, agent: str) -> str:
    """Return the means of an agent over all of its pieces."""
    parts = []
    for name, mark in (("note_onset_f1", "bars"), ("f1", "dots")):
        mean = summary.groups[0].agents[agent].mean[name]
        value, interval = metric_text(name, mean.value), interval_text(name, mean)
        text = f"{METRICS[name].title} ({mark}) {value}"
        parts.append(f"{text} (95 %: {interval})" if interval else text)
    return f"means: {', '.join(parts)}"


_ABOUT_A_PIECE = ("piece", "title", "composer", "library", "difficulty", "seconds", "notes")
_FINGER_REWARDS = ("return", "reward/fingering")
Row = Mapping[str, Any]


def write_tables(folder: Path, summary: BenchSummary) -> list[str]:
    """Write agents.csv, pieces.csv and runs.csv; return their names."""
    tables = {
        "agents": list(_agents(summary)),
        "pieces": list(_pieces(summary)),
        "runs": list(_runs(summary, folder)),
    }
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
    """Yield the metrics of every run, and all else that was measured."""
    measured = list(dict.fromkeys(name for run in summary.runs for name in run.result.metrics))
    for run in summary.runs:
        result = run.result
        row = {"piece": summary.pieces[run.piece].name, "agent": run.agent, "seed": result.seed}
        row |= {name: run.metrics[name] for name in METRICS}
        row |= {
            _column(name, result): result.metrics.get(name)
            for name in measured
            if name not in METRICS
        }
        row |= vars(result.timing)
        row |= {f"{name}_version": version for name, version in result.versions.items()}
        yield row | {"folder": Path(os.path.relpath(result.folder, folder)).as_posix()}


def _column(name: str, result: Result) -> str:
    """Return the column of a metric: the reward for other fingers is another metric."""
    fingers = result.metrics.get("rewarded_fingers")
    return f"{name}, fingers: {fingers}" if name in _FINGER_REWARDS and fingers else name


def _ends(name: str, estimate: Estimate) -> dict[str, float]:
    value, low, high = map(float, estimate)
    return {name: value, f"{name}_low": low, f"{name}_high": high}


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows as a CSV file; its columns are all names that any row has."""
    text = io.StringIO(newline="")
    names = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    with write_atomically(path) as file:
        file.write(text.getvalue().encode("utf-8", "replace"))


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value
