"""Bars from 0 to 1 beside each other, as plain HTML."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from typing import NamedTuple


class Bar(NamedTuple):
    """One of them."""

    name: str
    value: float
    """0 to 1; NaN for none."""
    shown: str
    """The value in words."""
    dots: Sequence[float] = ()
    """What the value is the mean of."""
    interval: tuple[float, float] | None = None
    """Where it lies, from and to."""
    kind: str = ""
    """Its class in the style sheet, if it has a colour of its own."""


def bars(title: str, lines: Sequence[Bar]) -> str:
    """A section with a line for each."""
    drawn = "".join(
        f"<dt>{html.escape(bar.name)}</dt><dd><span>{_marks(bar)}</span><b>{bar.shown}</b></dd>"
        for bar in lines
    )
    return f"<section><h3>{html.escape(title)}</h3><dl>{drawn}</dl></section>"


def _marks(bar: Bar) -> str:
    kind = f' class="{bar.kind}"' if bar.kind else ""
    marks = "" if math.isnan(bar.value) else f'<i{kind} style="width:{_percent(bar.value)}"></i>'
    marks += "".join(f'<u style="left:{_percent(dot)}"></u>' for dot in bar.dots if dot == dot)
    if bar.interval and not math.isnan(sum(bar.interval)):
        low, high = (min(max(end, 0.0), 1.0) for end in bar.interval)
        marks += (
            f'<u class="interval" style="left:{_percent(low)};width:{_percent(high - low)}"></u>'
        )
    return marks


def _percent(share: float) -> str:
    return f"{100 * min(max(share, 0.0), 1.0):.1f}%"
