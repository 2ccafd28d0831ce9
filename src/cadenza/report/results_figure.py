"""The bar chart of all pieces as an SVG picture."""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from cadenza.files import write_atomically
from cadenza.report.overview import (
    FIGURES,
    Overview,
    Standing,
    in_interval,
    same_in_words,
    shown,
)

_FIGURE, _BESIDE = "f1", "note_onset_f1"  # the bars, and the marks on them
_WIDTH, _LEFT, _RIGHT = 1200, 48, 16  # [px]
_HEIGHT_OF_ONE, _HEIGHT = 320, 150  # [px] of the chart of a single agent, and of one of several
_TITLE, _GAP = 34, 10  # [px] above a chart, and below it
_NAMED = 13  # [px] a column has to be this wide for its name
_LONGEST = 26  # characters of a name
_STYLE = """
  svg { --card: #ffffff; --ink: #14181f; --soft: #566070; --line: #e2e5ea; --bar: #2f5bd7;
    font: 13px system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
  @media (prefers-color-scheme: dark) { svg {
    --card: #161a21; --ink: #e9edf3; --soft: #a0aab9; --line: #2b323d; --bar: #86a8ff; } }
  .card { fill: var(--card); } .bar { fill: var(--bar); } .grid { stroke: var(--line); }
  .interval { stroke: var(--ink); fill: none; }
  .beside { fill: var(--card); stroke: var(--ink); stroke-width: 1.5; }
  text { fill: var(--soft); } .agent { fill: var(--ink); font-weight: 600; }
  .end { text-anchor: end; }
"""


def write_figure(path: Path, overview: Overview) -> None:
    """Draws the F1 of all pieces with its intervals, a chart an agent, in the order of the best.

    A dot is the note onset F1 of the piece.
    """
    with write_atomically(path) as file:
        file.write("\n".join(_drawn(overview)).encode("utf-8", "replace"))


def _drawn(overview: Overview) -> Iterator[str]:
    best = overview.of_pieces[_FIGURE].value[0]
    order = np.argsort(-best, kind="stable").tolist()  # what the best has not played comes last
    column = (_WIDTH - _LEFT - _RIGHT) / len(order)
    names = [_short(overview.pieces[i].title) for i in order] if column >= _NAMED else []
    height = _HEIGHT_OF_ONE if len(overview.agents) == 1 else _HEIGHT
    charts = (_TITLE + height + _GAP) * len(overview.agents)
    total = charts + 10 + round(6.8 * max(map(len, names), default=0))
    words = f"F1 and note onset F1 of {len(order)} pieces by {', '.join(overview.agents)}"
    yield (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {total}" role="img">'
        f"<title>{html.escape(words)}</title><style>{_STYLE}</style>"
    )
    yield f'<rect class="card" width="{_WIDTH}" height="{total}" rx="10"/>'
    for agent in range(len(overview.agents)):
        top = _TITLE + (_TITLE + height + _GAP) * agent
        yield f'<g transform="translate({_LEFT} {top})">'
        yield from _chart(overview, agent, order, column, height)
        yield "</g>"
    for place, name in enumerate(names):
        at = f"{_LEFT + (place + 0.5) * column + 4:.2f} {charts}"
        yield (
            f'<text class="end" transform="translate({at}) rotate(-90)">{html.escape(name)}</text>'
        )
    yield "</svg>\n"


def _chart(
    overview: Overview, agent: int, order: Sequence[int], column: float, height: int
) -> Iterator[str]:
    """The bars of an agent, and above them who it is."""
    name = overview.agents[agent]
    told = html.escape(_told(overview.groups[0].standings[name]))
    yield f'<text class="agent" y="-12">{html.escape(name)}</text>'
    yield f'<text class="end" x="{_WIDTH - _LEFT - _RIGHT}" y="-12">{told}</text>'
    for tick in (0, 0.25, 0.5, 0.75, 1):
        y = _y(tick, height)
        yield f'<path class="grid" d="M0 {y:g}H{_WIDTH - _LEFT - _RIGHT}"/>'
        yield f'<text class="end" x="-8" y="{y + 4:g}">{tick:g}</text>'
    bar = min(0.76 * column, 44)
    onsets = overview.of_pieces[_BESIDE].value[agent][order].tolist()
    columns = [part[agent][order].tolist() for part in overview.of_pieces[_FIGURE]]
    values = zip(order, *columns, onsets, strict=True)
    for place, (i, value, low, high, onset) in enumerate(values):
        if math.isnan(value):
            continue
        x, y = (place + 0.5) * column, _y(value, height)
        both = f"F1 {shown(_FIGURE, value)}, note onset F1 {shown(_BESIDE, onset)}"
        title = html.escape(f"{overview.pieces[i].title}: {both}")
        yield (
            f'<rect class="bar" x="{x - bar / 2:.2f}" y="{y:.2f}" width="{bar:.2f}"'
            f' height="{height - y:.2f}"><title>{title}</title></rect>'
        )
        if not math.isnan(low):
            yield _interval(x, _y(low, height), _y(high, height), min(bar / 4, 5))
        if not math.isnan(onset):
            at = f'cx="{x:.2f}" cy="{_y(onset, height):.2f}"'
            yield f'<circle class="beside" {at} r="{min(bar / 4, 3):.2f}"/>'


def _told(standing: Standing) -> str:
    """The interquartile means of an agent, and how many pieces its seeds made no difference to."""
    parts = []
    for name, drawn in ((_FIGURE, "bars"), (_BESIDE, "dots")):
        interval = in_interval(name, standing.iqm[name])
        value = f"{FIGURES[name].title} ({drawn}) {shown(name, standing.iqm[name].value)}"
        parts.append(f"{value} (95 %: {interval})" if interval else value)
    told = f"interquartile means: {', '.join(parts)}"
    if standing.repeated:
        told += f"; same with every seed: {same_in_words(standing)} pieces"
    return told


def _interval(x: float, low: float, high: float, wide: float) -> str:
    ends = "".join(f"M{x - wide:.2f} {y:.2f}h{2 * wide:.2f}" for y in (low, high))
    return f'<path class="interval" d="M{x:.2f} {low:.2f}V{high:.2f}{ends}"/>'


def _short(title: str) -> str:
    return title if len(title) <= _LONGEST else f"{title[: _LONGEST - 1]}…"


def _y(share: float, height: int) -> float:
    """[px] from above."""
    return height * (1 - min(max(share, 0.0), 1.0))
