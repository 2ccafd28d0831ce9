"""A chart of lines in HTML and SVG; `training.css` has its looks."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

LARGEST = 1e300
"""Values are drawn up to this, so that their differences have a size."""
_SIZE = 1000  # of a drawing, in its own units; it is stretched to the room that there is
_DOTTED = 40  # lines of no more points than this show each of them
_SPACES = 5.5  # ticks are no closer than such a part of the axis: labels fit a narrow screen
_MINUTE, _HOUR = 60, 3600  # [s]
_TIMES: list[float] = [n * unit for unit in (1, _MINUTE) for n in (1, 2, 5, 10, 20)]
_TIMES += [n * _HOUR for n in (0.5, 1, 2, 3, 6, 12, 24, 48, 120, 240)]


class Points(NamedTuple):
    """What a line goes through, each (n,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]


class Line(NamedTuple):
    """A line of a chart; a single point is drawn as a dot."""

    kind: str
    """Its class in the style sheet."""
    name: str
    points: Points
    band: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
    """Lowest and highest value (n,) at each point; what is between them is tinted."""


@dataclass(frozen=True)
class Axis:
    """From `low` to `high`, with `labels` at `ticks`."""

    low: float
    high: float
    ticks: Sequence[float]
    labels: Sequence[str]
    log: bool = False
    seconds: bool = False

    def shares(self, values: ArrayLike) -> NDArray[np.float64]:
        """How far along the axis values (n,) lie, 0..1."""
        scale = np.log10 if self.log else np.asarray
        low, high, along = scale(self.low), scale(self.high), scale(np.asarray(values, float))
        return (along - low) / (high - low)


def count_axis(high: float) -> Axis:
    """From 0 to `high` > 0."""
    ticks = _multiples(_round_step(high), 0, high)
    return Axis(0, high, ticks, _labels(ticks))


def time_axis(high: float) -> Axis:
    """From 0 to `high` > 0 [s]."""
    if high > _TIMES[-1] * _SPACES:
        hours = count_axis(high / _HOUR)
        ticks = [_HOUR * tick for tick in hours.ticks]
        labels = [label if label == "0" else f"{label} h" for label in hours.labels]
        return Axis(0, high, ticks, labels, seconds=True)
    step = next((time for time in _TIMES if time * _SPACES >= high), _TIMES[-1])
    unit, name = (_HOUR, "h") if step >= _HOUR / 2 else (_MINUTE, "min") if step >= 60 else (1, "s")
    ticks = _multiples(step, 0, high)
    return Axis(
        0, high, ticks, ["0", *(f"{tick / unit:g} {name}" for tick in ticks[1:])], seconds=True
    )


def value_axis(values: NDArray[np.float64]) -> Axis:
    """Holds all `values` (n,), n > 0, of at most `LARGEST`, between round numbers."""
    low, high = values.min(), values.max()
    if math.isclose(low, high, rel_tol=1e-6):
        margin = abs(low) / 2 or 1
        low, high = low - margin, high + margin
    step = _round_step(high - low)
    low, high = math.floor(low / step) * step, math.ceil(high / step) * step
    ticks = _multiples(step, low, high)
    return Axis(low, high, ticks, _labels(ticks))


def log_axis(values: NDArray[np.float64]) -> Axis:
    """Holds all `values` (n,) > 0, n > 0, between round numbers, on a logarithmic scale."""
    decades = range(math.floor(np.log10(values.min())) - 1, math.ceil(np.log10(values.max())) + 2)
    rounds = [float(f"{n}e{decade}") for decade in decades for n in (1, 2, 5)]
    low = max(r for r in rounds if r < values.min())
    high = min(r for r in rounds if r > values.max())
    ticks = [r for r in rounds if low <= r <= high]
    if len(ticks) > _SPACES:
        ticks = [r for r in ticks if f"{r:e}"[0] == "1"]
    ticks = ticks[:: math.ceil(len(ticks) / _SPACES)]
    return Axis(low, high, ticks, [in_short(tick) for tick in ticks], log=True)


def _round_step(span: float) -> float:
    """A round number of which at most `_SPACES` fit into `span`."""
    decade = 10.0 ** math.floor(math.log10(span / _SPACES))
    return next(n * decade for n in (1, 2, 5, 10) if n * decade * _SPACES >= span)


def _multiples(step: float, low: float, high: float) -> list[float]:
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [n * step for n in range(first, last + 1)]


def _labels(ticks: Sequence[float]) -> list[str]:
    """Of evenly spaced numbers: in one unit, with as many decimals as tell them apart."""
    largest, step = max(map(abs, ticks)), ticks[1] - ticks[0]
    if not 1e-3 <= largest < 1e9:
        digits = math.floor(math.log10(largest)) - math.floor(math.log10(step) + 1e-9) + 1
        return [f"{tick:.{digits}g}".replace("-", "−") for tick in ticks]
    size, name = _unit(largest)
    decimals = max(-math.floor(math.log10(step / size) + 1e-9), 0)
    texts = [f"{tick / size:z.{decimals}f}" for tick in ticks]
    return [f"{text}{name}".replace("-", "−") if float(text) else "0" for text in texts]


def _unit(value: float) -> tuple[float, str]:
    return (1e6, " M") if value >= 1e6 else (1e3, " k") if value >= 1e4 else (1, "")


def in_short(value: float) -> str:
    """Four digits of `value`, with thousands as k and millions as M."""
    size, name = _unit(abs(float(f"{value:.4g}")))
    return f"{value / size:,.4g}{name}".replace("-", "−")


def line_chart(title: str, along: str, x: Axis, y: Axis, lines: Sequence[Line]) -> str:
    """The chart of `lines`, later ones over earlier ones; `along` says what `x` is."""
    lines = [line for line in lines if len(line.points.x)]
    grid = "".join(f"M0 {_SIZE - _SIZE * share:.1f}h{_SIZE}" for share in y.shares(y.ticks))
    grid += "".join(f"M{_SIZE * share:.1f} 0v{_SIZE}" for share in x.shares(x.ticks))
    drawn = f'<path class="grid" d="{grid}"/>' + "".join(_drawn(line, x, y) for line in lines)
    ends = (f"{line.name} ends at {in_short(line.points.y[-1])}" for line in lines)
    words = html.escape(f"{title} by {along}: {', '.join(ends)}")
    return (
        f'<section class="plot"><h3>{html.escape(title)}</h3>'
        f'<div class="ys">{_spans("bottom", y)}</div>'
        f'<div class="drawing" data-along="{html.escape(along)}" data-x="{_scale(x)}" '
        f'data-y="{_scale(y)}">'
        f'<svg viewBox="0 0 {_SIZE} {_SIZE}" preserveAspectRatio="none" role="img" '
        f'aria-label="{words}">{drawn}</svg></div>'
        f'<div class="xs">{_spans("left", x)}</div><p>{html.escape(along)}</p></section>'
    )


def _scale(axis: Axis) -> str:
    """For the script that says what is under the pointer."""
    kind = "log" if axis.log else "seconds" if axis.seconds else "linear"
    return f"{kind} {axis.low:.12g} {axis.high:.12g}"


def _spans(side: str, axis: Axis) -> str:
    return "".join(
        f'<span style="{side}:{100 * share:.2f}%">{label}</span>'
        for share, label in zip(axis.shares(axis.ticks), axis.labels, strict=True)
    )


def _drawn(line: Line, x: Axis, y: Axis) -> str:
    across, down = _SIZE * x.shares(line.points.x), _SIZE - _SIZE * y.shares(line.points.y)
    places = [f"{i:.2f} {j:.2f}" for i, j in zip(across, down, strict=True)]
    paths = {}
    if line.band and len(places) > 1:
        edges = (_SIZE - _SIZE * y.shares(values) for values in line.band)
        low, high = ([f"{i:.2f} {j:.2f}" for i, j in zip(across, e, strict=True)] for e in edges)
        paths[f"{line.kind} band"] = f"M{'L'.join([*low, *reversed(high)])}z"
    if len(places) > 1:
        paths[line.kind] = "M" + "L".join(places)
    if len(places) <= _DOTTED:
        paths[f"{line.kind} dots"] = "".join(f"M{place}h0" for place in places)
    name = html.escape(line.name)
    return "".join(
        f'<path class="{kind}" d="{path}"><title>{name}</title></path>'
        for kind, path in paths.items()
    )
