"""The page that sums up many runs, and its chart of all pieces as an SVG picture."""

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from cadenza.errors import counted
from cadenza.evaluation.jobs import SongFacts
from cadenza.evaluation.results import PAGE
from cadenza.evaluation.summary import (
    COMPARED,
    METRICS,
    WRONG_NOTES,
    BenchSummary,
    Estimate,
    interval_text,
    metric_text,
    wrong_notes,
)
from cadenza.report.html_pages import render, write_page

_ABOUT = "Piece", "Library", "Difficulty", "Seconds", "Notes"  # columns of a table of pieces
_MAX_CASES = 12  # shown of a caveat
_MAX_SEEDS = 5  # listed one by one

_WIDTH, _LEFT, _RIGHT = 1200, 48, 16  # [px]
_HEIGHT = 150  # [px] of a chart
_TITLE, _GAP = 34, 10  # [px] above a chart, and below it
_LINE = 24  # [px] height of the names below a chart
_MIN_NAMED_COLUMN = 13  # [px] minimum width of a column with its name
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
        kinds=WRONG_NOTES,
        wrong_notes=wrong_notes(summary),
        agents=summary.agents,
        compared=COMPARED,
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
        page, shown = run.result.folder / PAGE, None
        if page.exists():
            shown = quote(os.fsencode(Path(os.path.relpath(page, folder)).as_posix()))
        runs.setdefault((run.piece, run.agent), []).append((run.result.seed, shown))
    for i, piece in enumerate(summary.pieces):
        for j, agent in enumerate(summary.agents):
            if pages := runs.get((i, agent)):
                means = {
                    name: Estimate(*(part[j, i] for part in estimate))
                    for name, estimate in summary.by_piece.items()
                }
                yield piece, agent, sorted(pages), means


def write_figure(path: Path, summary: BenchSummary) -> None:
    """Draw note onset F1 with its intervals, and F1 as dots, in a chart for each agent.

    The best piece comes first. A single piece has one chart, with a bar for each agent.
    """
    write_page(path, render("figure.svg", **_figure(summary)))


def _figure(summary: BenchSummary) -> dict[str, Any]:
    """The data of `figure.svg`: a chart for each row, and a bar in it for each column."""
    tables = [*summary.by_piece["note_onset_f1"], summary.by_piece["f1"].value]
    rows, columns = list(summary.agents), [piece.title for piece in summary.pieces]
    legends = [_means_text(summary, agent) for agent in rows]
    if len(columns) == 1:
        rows, columns, legends = columns, rows, ["note onset F1 (bars), F1 (dots)"]
        tables = [table.T for table in tables]
    order = np.argsort(-tables[0][0], kind="stable").tolist()  # NaN comes last
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
    """The means of an agent over all of its pieces."""
    parts = []
    for name, mark in (("note_onset_f1", "bars"), ("f1", "dots")):
        mean = summary.groups[0].agents[agent].mean[name]
        value, interval = metric_text(name, mean.value), interval_text(name, mean)
        text = f"{METRICS[name].title} ({mark}) {value}"
        parts.append(f"{text} (95 %: {interval})" if interval else text)
    return f"means: {', '.join(parts)}"
