"""The results of a bench as a folder of HTML pages, and as an SVG picture.

`index.html` has all pieces; `pieces/` has a page for each, which leads to the pages of its runs.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from cadenza.files import folder_name
from cadenza.report.bench_summary import (
    BARS,
    HEADLINES,
    IDENTICAL,
    METRICS,
    SHARES,
    THRESHOLDS,
    AgentSummary,
    BenchSummary,
    Estimate,
    Group,
    Piece,
    Run,
    identical_text,
    interval_text,
    metric_text,
)
from cadenza.report.charts import (
    SCRIPTS,
    STYLES,
    Bar,
    Line,
    LineChart,
    Points,
    counted,
    duration_text,
    line_chart,
    line_style,
)
from cadenza.report.html_pages import render, write_page

_STYLES = (*STYLES, "results.css")
_MEANS = {"f1": "Mean F1", "note_onset_f1": "Mean note onset F1"}  # beside interquartile means
_MAX_CASES = 12  # of a caveat that are spelt out
_MAX_SEEDS = 5  # that are named one by one
_MAX_FILE_NAME = 80  # characters
_DIGITS = 5  # significant, of a number in the data of the page


def write_results_pages(
    folder: Path, summary: BenchSummary, downloads: Sequence[str] = ()
) -> list[Path]:
    """Writes index.html and a page of each piece; returns their paths.

    Args:
        folder: where they go.
        summary: of at least one run.
        downloads: names of files beside index.html.
    """
    names = _page_names(summary.pieces)
    runs: dict[int, list[Run]] = {i: [] for i in range(len(summary.pieces))}
    for run in summary.runs:
        runs[run.piece].append(run)
    index, pieces = folder / "index.html", folder / "pieces"
    write_page(index, _index_page(summary, _data(summary, names, runs, folder), downloads))
    pages = [pieces / f"{name}.html" for name in names]
    for i, page in enumerate(pages):
        write_page(page, _piece_page(summary, i, runs[i], pieces))
    return [index, *pages]


def _page_names(pieces: Sequence[Piece]) -> list[str]:
    """Returns a name of a file for each, no two the same on any file system."""
    names: dict[str, None] = {}
    for piece in pieces:
        name = base = folder_name(piece.name)[:_MAX_FILE_NAME]
        number = 1
        while name.lower() in names:
            name = f"{base}-{(number := number + 1)}"
        names[name.lower()] = None
    return list(names)


def _render(template: str, **context: Any) -> Iterator[str]:
    return render(
        template,
        metrics=METRICS,
        metric_text=metric_text,
        interval_text=interval_text,
        styles=_STYLES,
        **context,
    )


# The page of all pieces


def _index_page(
    summary: BenchSummary, data: Mapping[str, Any], downloads: Sequence[str]
) -> Iterator[str]:
    return _render(
        "results.html",
        title=summary.title,
        facts=_facts(summary),
        caveats=summary.caveats,
        max_cases=_MAX_CASES,
        headline=_headline(summary),
        headlines=HEADLINES,
        best=summary.groups[0].agents[summary.agents[0]],
        shares=SHARES,
        agents=summary.agents,
        compared_on=_compared_on(summary),
        bar_charts={METRICS[name].title: _bars(summary, name) for name in BARS},
        means=_MEANS,
        columns=["Pieces", "Runs", IDENTICAL, *_MEANS.values(), *_metric_titles()],
        groups=summary.groups,
        identical_text=identical_text,
        counted=counted,
        choices=_choices(summary),
        line_styles=[(line_style(i), agent) for i, agent in enumerate(summary.agents)],
        profiles=_profiles(summary),
        downloads=downloads,
        data=data,
        scripts=(*SCRIPTS, "results.js"),
    )


def _metric_titles() -> list[str]:
    return [metric.title for metric in METRICS.values()]


def _facts(summary: BenchSummary) -> dict[str, str]:
    seeds = sorted({run.seed for run in summary.runs})
    return {
        "pieces": f"{len(summary.pieces):,}",
        "of music": duration_text(math.fsum(piece.seconds for piece in summary.pieces)),
        "agents": str(len(summary.agents)),
        "seeds": ", ".join(map(str, seeds)) if len(seeds) <= _MAX_SEEDS else str(len(seeds)),
        "runs": f"{len(summary.runs):,}",
    }


def _headline(summary: BenchSummary) -> str:
    """Returns whose metrics are at the top of the page."""
    first, rank = summary.agents[0], ""
    if len(summary.agents) > 1:
        means = [agent.mean["f1"].value for agent in summary.common.agents.values()]
        what = "the best" if means[0] == max(means) else "who played the most pieces"
        rank = f", {what} of {len(summary.agents)} agents"
    played = summary.groups[0].agents[first].pieces
    return f"{first}{rank}: mean of {counted(played, 'piece')}"


def _bars(summary: BenchSummary, name: str) -> list[Bar]:
    """Returns interquartile means of all agents, with their intervals."""
    return [
        Bar(agent, value, metric_text(name, value), interval=(low, high), style=line_style(i))
        for i, agent in enumerate(summary.agents)
        if agent in summary.common.agents
        for value, low, high in [summary.common.agents[agent].iqm[name]]
    ]


def _compared_on(summary: BenchSummary) -> str:
    """Returns which pieces the bars are of, where that is not all of them."""
    played = len(summary.common.pieces)
    if any(agent.pieces < played for agent in summary.common.agents.values()):
        return "No piece was played by all agents: the bars are of different pieces."
    if played < len(summary.pieces):
        pieces = counted(played, "piece")
        return f"Not all agents played all pieces. The bars are of the {pieces} that all played."
    return ""


def _choices(summary: BenchSummary) -> dict[str, tuple[str, Sequence[str]]]:
    """Returns what the charts and the table of pieces can show, each with its label."""
    groups = [f"{group.name} ({len(group.pieces)})" for group in summary.groups]
    return {
        "group": ("Pieces", groups),
        "metric": ("Metric", _metric_titles()),
        "agent": ("Agent", summary.agents),
    }


def _profiles(summary: BenchSummary) -> Iterator[tuple[int, int, LineChart]]:
    """Yields the chart of each group and metric, by their numbers; the page shows one of them."""
    for i, group in enumerate(summary.groups):
        for j, (name, metric) in enumerate(METRICS.items()):
            if name in SHARES and (lines := _profile(summary, group, name)):
                title = "Performance profile"
                yield i, j, line_chart(title, metric.title, 1.0, lines, y_unit="share")


def _profile(summary: BenchSummary, group: Group, metric: str) -> list[Line]:
    lines = []
    for i, agent in enumerate(summary.agents):
        if agent not in group.agents:
            continue
        value, low, high = group.agents[agent].profile[metric]
        band = None if np.isnan(low).any() else (low, high)
        if not np.isnan(value).any():
            lines.append(Line(line_style(i), agent, Points(THRESHOLDS, value), band))
    return lines


def _data(
    summary: BenchSummary, names: Sequence[str], runs: Mapping[int, Sequence[Run]], folder: Path
) -> dict[str, Any]:
    """Returns what results.js draws."""
    return {
        "metrics": [
            {"title": metric.title, "decimals": metric.decimals, "share": name in SHARES}
            for name, metric in METRICS.items()
        ],
        "agents": list(summary.agents),
        "groups": [{"name": g.name, "pieces": list(map(int, g.pieces))} for g in summary.groups],
        "pieces": [
            {
                "title": piece.title,
                "composer": piece.composer,
                "library": piece.library,
                "difficulty": _rounded(piece.difficulty),
                "seconds": _rounded(piece.seconds),
                "notes": piece.notes,
                "about": f"pieces/{quote(name)}.html",
                "pages": _run_addresses(summary.agents, runs[i], folder),
            }
            for i, (piece, name) in enumerate(zip(summary.pieces, names, strict=True))
        ],
        "values": [
            [_by_agent(part) for part in summary.by_piece[name]] for name in METRICS
        ],  # [metric][value, low, high][agent][piece]
    }


def _run_addresses(agents: Sequence[str], runs: Sequence[Run], folder: Path) -> list[str | None]:
    """Returns for each agent the address of the page of a run, None if it has none."""
    found = {run.agent: run for run in reversed(runs) if run.page}
    return [_address(found[agent], folder) if agent in found else None for agent in agents]


def _address(run: Run, folder: Path) -> str | None:
    if run.page is None:
        return None
    return quote(os.fsencode(Path(os.path.relpath(run.page, folder)).as_posix()))


def _by_agent(values: NDArray[np.float64]) -> list[list[float | None]]:
    return [[_rounded(value) for value in row] for row in values.tolist()]


def _rounded(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None


# The page of a piece


def _piece_page(
    summary: BenchSummary, index: int, runs: Sequence[Run], folder: Path
) -> Iterator[str]:
    piece = summary.pieces[index]
    facts = {"by": piece.composer} if piece.composer else {}
    facts |= {"from": piece.library, "length": duration_text(piece.seconds)}
    facts |= {"notes": f"{piece.notes:,}"}
    if not math.isnan(piece.difficulty):
        facts["difficulty"] = f"{piece.difficulty:.1f}"
    return _render(
        "piece.html",
        title=piece.title,
        facts=facts,
        bar_charts={METRICS[name].title: _piece_bars(summary, index, runs, name) for name in BARS},
        rows=_piece_rows(summary, index, runs, folder),
    )


def _piece_bars(summary: BenchSummary, index: int, runs: Sequence[Run], name: str) -> Iterator[Bar]:
    """Yields the mean of each agent, with a dot for each of several seeds."""
    for i, agent in enumerate(summary.agents):
        if each := [run.metrics[name] for run in runs if run.agent == agent]:
            value = float(summary.by_piece[name].value[i, index])
            dots = each if len(each) > 1 else ()
            yield Bar(agent, value, metric_text(name, value), dots, style=line_style(i))


def _piece_rows(
    summary: BenchSummary, index: int, runs: Sequence[Run], folder: Path
) -> Iterator[tuple[str, list[tuple[Run, str | None]], dict[str, Estimate]]]:
    """Yields each agent, its runs with the addresses of their pages, and its means."""
    for i, agent in enumerate(summary.agents):
        own = sorted((run for run in runs if run.agent == agent), key=lambda run: run.seed)
        means = {
            name: Estimate(*(part[i, index] for part in estimate))
            for name, estimate in summary.by_piece.items()
        }
        yield agent, [(run, _address(run, folder)) for run in own], means


# The picture of all pieces

_WIDTH, _LEFT, _RIGHT = 1200, 48, 16  # [px]
_SINGLE_HEIGHT, _HEIGHT = 320, 150  # [px] of the chart of a single agent, and of one of several
_TITLE, _GAP = 34, 10  # [px] above a chart, and below it
_MIN_NAMED_COLUMN = 13  # [px] a column has to be this wide for its name
_MAX_TITLE = 26  # characters of a name
_CHARACTER = 6.8  # [px] an average character is this wide
_BAR_SHARE, _MAX_BAR = 0.76, 44  # width of a bar, of its column and [px]
_MAX_CAP, _MAX_DOT = 5, 3  # [px] half the end of an interval, radius of a dot


def write_figure(path: Path, summary: BenchSummary) -> None:
    """Draws the F1 of all pieces with its intervals, a chart an agent, in the order of the best.

    A dot is the note onset F1 of the piece.
    """
    best = summary.by_piece["f1"].value[0]
    order = np.argsort(-best, kind="stable").tolist()  # what the best has not played comes last
    width = _WIDTH - _LEFT - _RIGHT
    column = width / len(order)
    is_named = column >= _MIN_NAMED_COLUMN
    names = [_shortened(summary.pieces[i].title) for i in order] if is_named else []
    height = _SINGLE_HEIGHT if len(summary.agents) == 1 else _HEIGHT
    bottom = (_TITLE + height + _GAP) * len(summary.agents)
    bar_width = min(_BAR_SHARE * column, _MAX_BAR)
    agents = ", ".join(summary.agents)
    page = render(
        "results_figure.svg",
        title=f"F1 and note onset F1 of {len(order)} pieces by {agents}",
        width=_WIDTH,
        height=bottom + _GAP + round(_CHARACTER * max(map(len, names), default=0)),
        left=_LEFT,
        chart_width=width,
        column=column,
        bar_width=bar_width,
        cap=min(bar_width / 4, _MAX_CAP),
        dot=min(bar_width / 4, _MAX_DOT),
        charts=[
            {
                "top": _TITLE + (_TITLE + height + _GAP) * number,
                "agent": agent,
                "means": _means_text(summary.groups[0].agents[agent]),
                "bars": _figure_bars(summary, number, order),
            }
            for number, agent in enumerate(summary.agents)
        ],
        names=names,
        names_top=bottom,
        y=lambda share: height * (1 - min(max(share, 0.0), 1.0)),
        px="{:.2f}".format,
    )
    write_page(path, page)


def _figure_bars(
    summary: BenchSummary, agent: int, order: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """Yields F1 with its interval, note onset F1 and a title of each piece."""
    f1, low, high = (part[agent] for part in summary.by_piece["f1"])
    onset_f1 = summary.by_piece["note_onset_f1"].value[agent]
    for i in order:
        texts = metric_text("f1", f1[i]), metric_text("note_onset_f1", onset_f1[i])
        title = "{}: F1 {}, note onset F1 {}".format(summary.pieces[i].title, *texts)
        yield {"title": title, "f1": f1[i], "low": low[i], "high": high[i], "onset_f1": onset_f1[i]}


def _means_text(agent: AgentSummary) -> str:
    """Returns the interquartile means of an agent, and how many pieces are the same every time."""
    parts = []
    for name, mark in (("f1", "bars"), ("note_onset_f1", "dots")):
        interval = interval_text(name, agent.iqm[name])
        value = f"{METRICS[name].title} ({mark}) {metric_text(name, agent.iqm[name].value)}"
        parts.append(f"{value} (95 %: {interval})" if interval else value)
    text = f"interquartile means: {', '.join(parts)}"
    if agent.repeated:
        text += f"; same with every seed: {identical_text(agent)} pieces"
    return text


def _shortened(title: str) -> str:
    return title if len(title) <= _MAX_TITLE else f"{title[: _MAX_TITLE - 1]}…"
