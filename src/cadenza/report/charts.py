"""Charts on pages: lines, which `curves.js` has uPlot draw, and bars of plain HTML."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

MAX_VALUE = 1e30
"""Largest value that is drawn: uPlot has no ticks beyond."""
STYLES = ("uplot.min.css", "page.css", "chart.css", "comparison.css", "training.css")
"""Style sheets of pages with line charts."""
SCRIPTS = ("elements.js", "chart.js", "curves.js")
"""Scripts that draw line charts."""
_NUM_COLOURS = 8  # that the style sheet has
_DIGITS = 6  # significant, of a value that is drawn


class Bar(NamedTuple):
    """A bar from 0 to 1."""

    name: str
    value: float
    """NaN where there is none."""
    text: str
    """The value as it is printed."""
    dots: Sequence[float] = ()
    """The values whose mean it is."""
    interval: tuple[float, float] | None = None
    """Confidence interval of the value."""
    style: str = ""
    """Class in the style sheet, if the bar has a colour of its own."""


class Points(NamedTuple):
    """Points of a line, each (n,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]


class Line(NamedTuple):
    """A line of a chart; a single point is drawn as a dot."""

    style: str
    """Class in the style sheet, where `--style` is its colour."""
    name: str
    points: Points
    band: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    """Lowest and highest value (n,) at each point; what is between them is tinted."""


class LineChart(NamedTuple):
    """A chart of lines as templates take it."""

    title: str
    description: str
    """A sentence that stands for the picture."""
    data: dict[str, Any]
    """The input of `curves.js`."""


def line_chart(
    title: str,
    x_label: str,
    x_end: float,
    lines: Sequence[Line],
    y_unit: Literal["number", "share", "log"] = "number",
) -> LineChart:
    """Returns the chart of `lines`, later ones over earlier ones.

    Args:
        title: of the chart.
        x_label: what x is.
        x_end: of the x axis, which begins at 0.
        lines: those without points are left out.
        y_unit: what the y axis measures; a share is drawn from 0 to 1.
    """
    lines = [line for line in lines if len(line.points.x)]
    ends = (f"{line.name} ends at {compact_number(line.points.y[-1])}" for line in lines)
    data = {"along": x_label, "end": x_end, "y": y_unit, "lines": list(map(_line_data, lines))}
    return LineChart(title, f"{title} by {x_label}: {', '.join(ends)}", data)


def _line_data(line: Line) -> dict[str, Any]:
    band = {"band": list(map(_rounded, line.band))} if line.band else {}
    x, y = map(_rounded, line.points)
    return {"kind": line.style, "name": line.name, "x": x, "y": y, **band}


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]


def line_style(number: int) -> str:
    """Returns the class in the style sheet of the `number`th line, from 0 on."""
    return f"run{number % _NUM_COLOURS}"


def duration_text(seconds: float) -> str:
    """Returns seconds up to two minutes, then minutes, and hours."""
    if round(seconds) < 120:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    if hours >= 10_000:
        return f"{compact_number(hours)} h"
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def compact_number(value: float) -> str:
    """Returns four digits of `value`, with thousands as k and millions as M."""
    size = abs(float(f"{value:.4g}"))
    unit, name = (1e6, " M") if size >= 1e6 else (1e3, " k") if size >= 1e4 else (1, "")
    return f"{value / unit:,.4g}{name}".replace("-", "−")


def counted(number: int, noun: str) -> str:
    """Returns a number and its noun, such as "1 run" or "2,000 runs"."""
    return f"{number:,} {noun}{'s'[: number != 1]}"


def mean_of_known(values: Sequence[float]) -> float:
    """Returns the mean of the values that are not NaN; NaN if all are."""
    known = [value for value in values if not math.isnan(value)]
    return math.fsum(known) / len(known) if known else math.nan


def fixed_number(value: float, decimals: int) -> str:
    """Returns `value` with so many decimals, a dash if it is NaN."""
    return "–" if math.isnan(value) else f"{value:z.{decimals}f}".replace("-", "−")
