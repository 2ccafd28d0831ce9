"""What many runs say of agents, as a folder of HTML pages: no network, no server.

`index.html` has all pieces; `pieces/` has a page for each, which leads to the pages of its runs.
"""

from __future__ import annotations

import html
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from cadenza.files import folder_name
from cadenza.report.asset import asset
from cadenza.report.bars import Bar, bars
from cadenza.report.line_chart import STYLES, Line, Points, coloured, in_time, legend, line_chart
from cadenza.report.overview import (
    DRAWN,
    FIGURES,
    HEADLINES,
    SAME,
    SHARES,
    THRESHOLDS,
    Estimate,
    Figure,
    Group,
    Overview,
    Piece,
    Run,
    in_interval,
    same_in_words,
    shown,
)
from cadenza.report.page import write_page
from cadenza.report.recording import in_json

_SCRIPTS = ("chart.js", "curves.js", "results.js")
_MEANS = {"f1": "Mean F1", "note_onset_f1": "Mean note onset F1"}  # beside interquartile means
_MOST_REMARKS = 12  # of a kind that are spelt out


def write_results_pages(
    folder: Path, overview: Overview, downloads: Sequence[str] = ()
) -> list[Path]:
    """Writes index.html and a page of each piece; gives their paths.

    Args:
        folder: where they go.
        overview: of at least one run.
        downloads: names of files beside index.html.
    """
    names = _page_names(overview.pieces)
    runs: dict[int, list[Run]] = {i: [] for i in range(len(overview.pieces))}
    for run in overview.runs:
        runs[run.piece].append(run)
    css = "".join(map(asset, (*STYLES, "results.css")))
    index, about = folder / "index.html", folder / "pieces"
    marks = [(coloured(i), agent) for i, agent in enumerate(overview.agents)]
    parts = {
        "title": html.escape(overview.title),
        "facts": _facts(overview),
        "downloads": _downloads(downloads),
        "remarks": _remarks(overview.remarks),
        "headlines": _headlines(overview),
        "bars": _side_by_side(overview),
        "head": _head(("Pieces", "Runs", SAME, *_MEANS.values()), FIGURES.values()),
        "standings": "".join(_standings(group) for group in overview.groups),
        "choices": _choices(overview),
        "legend": legend(marks) if len(marks) > 1 else "",
        "profiles": _profiles(overview),
        "meanings": _meanings(),
        "data": in_json(_data(overview, names, runs, folder)),
        "uplot": asset("uplot.min.js"),
        "js": "".join(map(asset, _SCRIPTS)),
        "css": css,
    }
    write_page(index, "results.html", parts)
    pages = [about / f"{name}.html" for name in names]
    for i, page in enumerate(pages):
        write_page(page, "piece.html", _piece_parts(overview, i, runs[i], about) | {"css": css})
    return [index, *pages]


def _page_names(pieces: Sequence[Piece]) -> list[str]:
    """A name of a file for each, no two the same on any file system."""
    names: dict[str, None] = {}
    for piece in pieces:
        name = base = folder_name(piece.name)[:80]
        number = 1
        while name.lower() in names:
            name = f"{base}-{(number := number + 1)}"
        names[name.lower()] = None
    return list(names)


# Words and figures


def _counted(number: int, what: str) -> str:
    return f"{number:,} {what}{'' if number == 1 else 's'}"


def _spans(facts: Mapping[str, str]) -> str:
    return "".join(f"<span>{name} <b>{html.escape(v)}</b></span>" for name, v in facts.items())


def _facts(overview: Overview) -> str:
    seeds = sorted({run.seed for run in overview.runs})
    facts = {
        "pieces": f"{len(overview.pieces):,}",
        "of music": in_time(math.fsum(piece.seconds for piece in overview.pieces)),
        "agents": str(len(overview.agents)),
        "seeds": ", ".join(map(str, seeds)) if len(seeds) < 6 else str(len(seeds)),
        "runs": f"{len(overview.runs):,}",
    }
    return _spans(facts)


def _downloads(names: Sequence[str]) -> str:
    return "".join(
        f'<a class="button" href="{quote(name)}" download>{html.escape(name)}</a>' for name in names
    )


def _remarks(remarks: Sequence[tuple[str, Sequence[str]]]) -> str:
    """A card, nothing if there are none."""
    if not remarks:
        return ""
    items = []
    for line, cases in remarks:
        told = [html.escape(case) for case in cases[:_MOST_REMARKS]]
        if len(cases) > len(told):
            told.append(f"and {len(cases) - len(told)} more, see results.json")
        each = "".join(f"<li>{case}</li>" for case in told)
        folded = f"<details><summary>{html.escape(line)}</summary><ul>{each}</ul></details>"
        items.append(f"<li>{folded if each else html.escape(line)}</li>")
    return (
        '<section class="card remarks" aria-labelledby="remarks-title">'
        f'<h2 id="remarks-title">Before you compare</h2><ul>{"".join(items)}</ul></section>'
    )


def _headlines(overview: Overview) -> str:
    """The figures of the first agent, with what they mean."""
    first = overview.agents[0]
    standing = overview.groups[0].standings[first]
    cards = []
    for name in HEADLINES:
        figure, estimate = FIGURES[name], standing.mean[name]
        bar = ""
        if name in SHARES and not math.isnan(estimate.value):
            bar = f'<div class="bar"><i style="width:{100 * estimate.value:.1f}%"></i></div>'
        interval = in_interval(name, estimate, " to ")
        small = f"<small>95 % interval {interval}</small>" if interval else ""
        if standing.repeated and standing.same == standing.repeated and name in SHARES:
            small = "<small>the same with every seed</small>"
        cards.append(
            f'<div class="score"><h3>{figure.title}</h3>'
            f'<p class="value">{shown(name, estimate.value)}</p>{bar}{small}'
            f"<p>{figure.meaning}</p></div>"
        )
    of = ""
    if len(overview.agents) > 1:
        means = [standing.mean["f1"].value for standing in overview.fair.standings.values()]
        what = "the best" if means[0] == max(means) else "who played the most pieces"
        of = f", {what} of {len(overview.agents)} agents"
    played = _counted(standing.pieces, "piece")
    return (
        f'<h2 id="headlines-title">{html.escape(first)}{of}: mean of {played}</h2>'
        f'<div class="scores">{"".join(cards)}</div>'
    )


def _side_by_side(overview: Overview) -> str:
    """Interquartile means of all agents, with their intervals; nothing for a single agent."""
    if len(overview.agents) == 1:
        return ""
    panels = []
    for name in DRAWN:
        lines = []
        for i, agent in enumerate(overview.agents):
            if agent in overview.fair.standings:
                value, low, high = overview.fair.standings[agent].iqm[name]
                kind, words = coloured(i), shown(name, value)
                lines.append(Bar(agent, value, words, interval=(low, high), kind=kind))
        panels.append(bars(FIGURES[name].title, lines))
    return f'{_compared_on(overview)}<div class="bars">{"".join(panels)}</div>'


def _compared_on(overview: Overview) -> str:
    """Which pieces the bars are of, where that is not all of them."""
    played = len(overview.fair.pieces)
    if any(s.pieces < played for s in overview.fair.standings.values()):
        return "<p>No piece was played by all agents: the bars are of different pieces.</p>"
    if played < len(overview.pieces):
        of = _counted(played, "piece")
        return f"<p>Not all agents played all pieces. The bars are of the {of} that all played.</p>"
    return ""


def _head(first: Sequence[str], figures: Iterable[Figure]) -> str:
    titles = [*first, *(figure.title for figure in figures)]
    return "".join(f'<th scope="col">{title}</th>' for title in titles)


def _standings(group: Group) -> str:
    """The rows of a group: its name, and one of each agent."""
    columns = 4 + len(_MEANS) + len(FIGURES)
    rows = [
        f'<tr class="group"><th scope="rowgroup" colspan="{columns}">{html.escape(group.name)}'
        f" <small>{_counted(len(group.pieces), 'piece')}</small></th></tr>"
    ]
    for agent, standing in group.standings.items():
        cells = [f"<td>{standing.pieces:,}</td><td>{standing.runs:,}</td>"]
        cells.append(f"<td>{same_in_words(standing)}</td>")
        cells += [_cell(name, standing.mean[name]) for name in _MEANS]
        cells += [_cell(name, standing.iqm[name]) for name in FIGURES]
        rows.append(f'<tr><th scope="row">{html.escape(agent)}</th>{"".join(cells)}</tr>')
    return f"<tbody>{''.join(rows)}</tbody>"


def _cell(figure: str, estimate: Estimate) -> str:
    interval = in_interval(figure, estimate)
    small = f"<small>{interval}</small>" if interval else ""
    return f"<td>{shown(figure, estimate.value)}{small}</td>"


def _choices(overview: Overview) -> str:
    """What the charts below and the table of pieces are to show."""
    groups = [f"{group.name} ({len(group.pieces)})" for group in overview.groups]
    titles = [figure.title for figure in FIGURES.values()]
    offered = {"group": ("Pieces", groups), "figure": ("Figure", titles)}
    offered["agent"] = ("Agent", list(overview.agents))
    return "".join(
        f"<label{' hidden' * (len(options) == 1)}>{label} {_select(name, options)}</label>"
        for name, (label, options) in offered.items()
    )


def _select(name: str, options: Sequence[str]) -> str:
    each = (f'<option value="{i}">{html.escape(text)}</option>' for i, text in enumerate(options))
    return f'<select id="{name}">{"".join(each)}</select>'


def _meanings() -> str:
    rows = (
        f'<tr><th scope="row">{figure.title}</th><td>{figure.meaning}</td></tr>'
        for figure in FIGURES.values()
    )
    return f"<table>{''.join(rows)}</table>"


# Charts


def _profiles(overview: Overview) -> str:
    """A chart of each figure and group; the page shows one of them."""
    charts = []
    for i, group in enumerate(overview.groups):
        for j, (name, figure) in enumerate(FIGURES.items()):
            if name in SHARES:
                lines = _profile(overview, group, name)
                chart = line_chart("Performance profile", figure.title, 1.0, lines, y="share")
                of = f'data-group="{i}" data-figure="{j}"'
                charts.append(f'<div class="profile" {of} hidden>{chart}</div>')
    return "".join(charts)


def _profile(overview: Overview, group: Group, figure: str) -> list[Line]:
    lines = []
    for i, agent in enumerate(overview.agents):
        if agent not in group.standings:
            continue
        value, low, high = group.standings[agent].profile[figure]
        band = None if np.isnan(low).any() else (low, high)
        if not np.isnan(value).any():
            lines.append(Line(coloured(i), agent, Points(THRESHOLDS, value), band))
    return lines


def _data(
    overview: Overview, names: Sequence[str], runs: Mapping[int, Sequence[Run]], folder: Path
) -> dict[str, Any]:
    """What results.js draws."""
    return {
        "figures": [
            {"title": figure.title, "decimals": figure.decimals, "share": name in SHARES}
            for name, figure in FIGURES.items()
        ],
        "agents": list(overview.agents),
        "groups": [{"name": g.name, "pieces": list(map(int, g.pieces))} for g in overview.groups],
        "pieces": [
            {
                "title": piece.title,
                "composer": piece.composer,
                "library": piece.library,
                "difficulty": _rounded(piece.difficulty),
                "seconds": _rounded(piece.seconds),
                "notes": piece.notes,
                "about": f"pieces/{quote(name)}.html",
                "pages": _pages(overview.agents, runs[i], folder),
            }
            for i, (piece, name) in enumerate(zip(overview.pieces, names, strict=True))
        ],
        "values": [
            [_by_agent(part) for part in overview.of_pieces[name]] for name in FIGURES
        ],  # of figures, of value, low and high, of agents, of pieces
    }


def _pages(agents: Sequence[str], runs: Sequence[Run], folder: Path) -> list[str | None]:
    """Of each agent the address of a run's page, None if it has none."""
    found = {run.agent: run.page for run in reversed(runs) if run.page}
    return [_address(found[agent], folder) if agent in found else None for agent in agents]


def _address(page: Path, folder: Path) -> str:
    return quote(os.fsencode(Path(os.path.relpath(page, folder)).as_posix()))


def _by_agent(values: NDArray[np.float64]) -> list[list[float | None]]:
    return [[_rounded(value) for value in row] for row in values.tolist()]


def _rounded(value: float) -> float | None:
    return float(f"{value:.5g}") if math.isfinite(value) else None


# The page of a piece


def _piece_parts(
    overview: Overview, index: int, runs: Sequence[Run], folder: Path
) -> dict[str, str]:
    piece = overview.pieces[index]
    facts = {"from": piece.library, "length": in_time(piece.seconds), "notes": f"{piece.notes:,}"}
    if piece.composer:
        facts = {"by": piece.composer, **facts}
    if not math.isnan(piece.difficulty):
        facts["difficulty"] = f"{piece.difficulty:.1f}"
    return {
        "title": html.escape(piece.title),
        "facts": _spans(facts),
        "bars": "".join(_piece_bars(overview, index, runs)),
        "head": _head((), FIGURES.values()),
        "rows": "".join(_piece_rows(overview, index, runs, folder)),
    }


def _piece_bars(overview: Overview, index: int, runs: Sequence[Run]) -> Iterator[str]:
    """The mean of each agent, with a dot for each of several seeds."""
    for name in DRAWN:
        lines = []
        for i, agent in enumerate(overview.agents):
            dots = [run.figures[name] for run in runs if run.agent == agent]
            value = float(overview.of_pieces[name].value[i, index])
            if dots:
                shown_dots = dots if len(dots) > 1 else ()
                words = shown(name, value)
                lines.append(Bar(agent, value, words, shown_dots, kind=coloured(i)))
        yield bars(FIGURES[name].title, lines)


def _piece_rows(overview: Overview, index: int, runs: Sequence[Run], folder: Path) -> Iterator[str]:
    """A row a run, and after several of an agent their mean."""
    for i, agent in enumerate(overview.agents):
        own = sorted((run for run in runs if run.agent == agent), key=lambda run: run.seed)
        for run in own:
            page = "<span>no page was kept</span>"
            if run.page:
                address = html.escape(_address(run.page, folder))
                page = f'<a href="{address}">piano roll and 3D</a>'
            cells = "".join(f"<td>{shown(name, run.figures[name])}</td>" for name in FIGURES)
            name = f"{html.escape(agent)} <small>seed {run.seed}</small>"
            yield f'<tr><th scope="row">{name}</th>{cells}<td class="page">{page}</td></tr>'
        if len(own) > 1:
            cells = "".join(
                _cell(name, Estimate(*(part[i, index] for part in overview.of_pieces[name])))
                for name in FIGURES
            )
            name = f"mean of {html.escape(agent)}"
            yield f'<tr class="mean"><th scope="row">{name}</th>{cells}<td></td></tr>'
