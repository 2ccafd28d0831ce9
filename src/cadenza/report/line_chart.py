"""A chart of lines as HTML: the numbers, which `curves.js` has uPlot draw."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.report.recording import in_json

LARGEST = 1e30
"""Values are drawn up to this: uPlot has no ticks beyond."""
STYLES = ("uplot.min.css", "page.css", "chart.css", "comparison.css", "training.css")
"""Style sheets of pages with such charts."""
_COLOURS = 8  # that the style sheet has


class Points(NamedTuple):
    """What a line goes through, each (n,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]


class Line(NamedTuple):
    """A line of a chart; a single point is drawn as a dot."""

    kind: str
    """Its class in the style sheet, where `--kind` is its colour."""
    name: str
    points: Points
    band: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    """Lowest and highest value (n,) at each point; what is between them is tinted."""


def line_chart(
    title: str,
    along: str,
    end: float,
    lines: Sequence[Line],
    x: Literal["number", "seconds"] = "number",
    y: Literal["number", "share", "log"] = "number",
) -> str:
    """The chart of `lines`, later ones over earlier ones.

    Args:
        title: of the chart.
        along: what x is.
        end: of the x axis, which begins at 0.
        lines: of which those without points are left out.
        x: what the axis measures.
        y: likewise; a share is drawn from 0 to 1.
    """
    lines = [line for line in lines if len(line.points.x)]
    chart = {"along": along, "end": end, "x": x, "y": y, "lines": list(map(_embedded, lines))}
    ends = (f"{line.name} ends at {in_short(line.points.y[-1])}" for line in lines)
    words = html.escape(f"{title} by {along}: {', '.join(ends)}")
    return (
        f'<section class="plot"><h3>{html.escape(title)}</h3>'
        f'<div class="curves" data-words="{words}">'
        f'<script type="application/json">{in_json(chart)}</script></div></section>'
    )


def _embedded(line: Line) -> dict[str, object]:
    band = {"band": list(map(_rounded, line.band))} if line.band else {}
    x, y = map(_rounded, line.points)
    return {"kind": line.kind, "name": line.name, "x": x, "y": y, **band}


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.6g}") for value in values]


def coloured(number: int) -> str:
    """The kind of the `number`th line, from 0 on, among others like it."""
    return f"run{number % _COLOURS}"


def legend(marks: Iterable[tuple[str, str]]) -> str:
    """Which line is which, by pairs of a kind and a name."""
    shown = (f'<span><i class="{kind}"></i>{html.escape(name)}</span>' for kind, name in marks)
    return f'<p class="legend">{"".join(shown)}</p>'


def in_time(seconds: float) -> str:
    """Seconds up to two minutes, then minutes, and hours."""
    if round(seconds) < 120:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    if hours >= 10_000:
        return f"{in_short(hours)} h"
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def in_short(value: float) -> str:
    """Four digits of `value`, with thousands as k and millions as M."""
    size = abs(float(f"{value:.4g}"))
    unit, name = (1e6, " M") if size >= 1e6 else (1e3, " k") if size >= 1e4 else (1, "")
    return f"{value / unit:,.4g}{name}".replace("-", "−")
