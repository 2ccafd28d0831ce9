"""A chart of lines in HTML and SVG; `training.css` has its looks."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_SIZE = 1000  # of a drawing, in its own units; it is stretched to the room that there is
_DOTTED = 40  # lines of no more points than this show each of them
_SPACES = 5  # between ticks at most, so that the labels fit a narrow screen
_MINUTE, _HOUR = 60, 3600  # [s]
_TIMES = [n * unit for unit in (1, _MINUTE) for n in (1, 2, 5, 10, 20)]
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


@dataclass(frozen=True)
class Axis:
    """From `low` to `high`, with labels at some values."""

    low: float
    high: float
    ticks: Sequence[float]
    labels: Sequence[str]
    log: bool = False

    def shares(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """How far along the axis values (n,) lie, 0..1."""
        ends = np.array([self.low, self.high])
        if self.log:
            values, ends = np.log10(values), np.log10(ends)
        return (values - ends[0]) / (ends[1] - ends[0])


def ratio_axis() -> Axis:
    """From 0 to 1."""
    ticks = [tick / 5 for tick in range(6)]
    return Axis(0, 1, ticks, [f"{tick:g}" for tick in ticks])


def count_axis(high: float) -> Axis:
    """From 0 to `high` > 0."""
    ticks = _multiples(_round_step(high), 0, high)
    return Axis(0, high, ticks, [in_short(tick) for tick in ticks])


def time_axis(high: float) -> Axis:
    """From 0 to `high` > 0 [s]."""
    step = next((time for time in _TIMES if time * _SPACES >= high), _TIMES[-1])
    unit, name = next((u, n) for u, n in ((1800, "h"), (60, "min"), (0, "s")) if step >= u)
    size = {"h": _HOUR, "min": _MINUTE, "s": 1}[name]
    ticks = _multiples(step, 0, high)
    return Axis(0, high, ticks, [f"{tick / size:g} {name}" if tick else "0" for tick in ticks])
