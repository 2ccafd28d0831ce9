"""Learning curves of training runs as one HTML file.

Plain HTML with drawings in SVG: no script, no network, no server.
"""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cadenza.report.page import asset, write_page

_CHARTS = {
    "eval/note_onset_f1": ("Note onset F1", False),
    "episodes/f1": ("F1 of training episodes", False),
    "episodes/return": ("Return of training episodes", False),
    "train/critic_loss": ("Critic’s loss", True),
    "train/actor_loss": ("Actor’s loss", False),
    "train/value": ("Value", False),
    "train/entropy": ("Entropy", False),
    "train/temperature": ("Temperature", True),
}
"""Columns of the rows -> the titles of their charts, and whether the scale is logarithmic."""
_REWARD = "eval/reward/"
_SIZE = 1000  # of a drawing, in its own units; it is stretched to the room there is
_DOTTED = 30  # lines of no more points than this show each
_TICKS = 5  # spaces between ticks at most, so that the labels fit a narrow screen
_MINUTE, _HOUR = 60, 3600  # [s]
_TIMES = [unit * n for unit in (1, _MINUTE) for n in (1, 2, 5, 10, 20, 30)]
_TIMES += [_HOUR * n for n in (1, 2, 3, 6, 12, 24, 48, 120, 240)]


@dataclass(frozen=True)
class Curve:
    """What is known of one training run."""

    name: str
    rows: Sequence[Mapping[str, float | None]]
    """Oldest first, each with `step`, in control steps, and `seconds` of training until then.

    A row of an evaluation has `eval_step`, the step its policy is of, and columns `eval/...`;
    others have `updates`, `train/...` and `episodes/...`, where these are known.
    """


class _Points(NamedTuple):
    """What a line goes through, each (n,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    ticks: Mapping[float, str]
    """Value -> label."""
    log: bool = False

    def shares(self, values: ArrayLike) -> NDArray[np.float64]:
        """How far along the axis values (n,) lie, 0..1."""
        scale = np.log10 if self.log else np.asarray
        low, high = scale(self.low), scale(self.high)
        return (scale(np.asarray(values, float)) - low) / (high - low)


class _Line(NamedTuple):
    kind: str
    """Its class in the style sheet."""
    name: str
    points: _Points


def write_training(
    path: Path,
    title: str,
    runs: Sequence[Curve],
    settings: Mapping[str, Any],
    links: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Writes the page of learning curves to `path`.

    Args:
        title: what was learnt.
        runs: at least one.
        settings: name -> value, nested or not. None is not shown.
        links: label -> relative address of another page.
    """
    parts = {
        "title": html.escape(title),
        "facts": _about(runs, links),
        "headline": _table(runs) if len(runs) > 1 else _cards(_figures(runs[0])),
        "playing": _playing(runs),
        "learning": _learning(runs),
        "settings": _settings(settings),
        "css": asset("page.css") + asset("training.css"),
    }
    write_page(path, "training.html", parts)


# What the rows tell


def _points(run: Curve, column: str) -> _Points:
    """A column against control steps, without the rows that do not have it."""
    found = [
        (row.get("eval_step", row["step"]), row[column])
        for row in run.rows
        if row.get(column) is not None
    ]
    x, y = np.array(found, float).reshape(-1, 2).T
    return _Points(x[np.isfinite(y)], y[np.isfinite(y)])


def _seconds(run: Curve, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wall time [s] at which training reached each of `steps` (n,).

    An evaluation ends while training goes on: the time in its own row is too late.
    """
    known = [(0, 0), *((row["step"], row["seconds"]) for row in run.rows)]
    return np.interp(steps, *np.array(known, float).T)


def _thinned(points: _Points, most: int) -> _Points:
    """Means over neighbours, of `most` groups of them."""
    if len(points.x) <= most:
        return points
    first = np.linspace(0, len(points.x), most, endpoint=False).astype(int)
    size = np.diff(first, append=len(points.x))
    return _Points(*(np.add.reduceat(values, first) / size for values in points))


def _mean(lines: Sequence[_Points]) -> _Points:
    """The mean of lines, where all those are that have any points."""
    lines = [line for line in lines if len(line.x)]
    x = np.unique(np.concatenate([np.empty(0), *(line.x for line in lines)]))
    for line in lines:
        x = x[(line.x[0] <= x) & (x <= line.x[-1])]
    return _Points(x, np.mean([np.interp(x, *line) for line in lines] or [x], axis=0))


def _last(run: Curve, column: str) -> float:
    return next((v for row in reversed(run.rows) if (v := row.get(column)) is not None), math.nan)


def _figures(run: Curve) -> dict[str, float]:
    """Those of `_FIGURES`; NaN where one is not known yet."""
    step, seconds, f1 = _last(run, "step"), _last(run, "seconds"), _points(run, "eval/f1")
    best = slice(f1.y.argmax(), None) if len(f1.y) else slice(0)
    of_best = (f1.y[best], f1.x[best], _seconds(run, f1.x[best]), f1.y[::-1])
    best_f1, best_step, best_seconds, last_f1 = (
        float(values[0]) if len(values) else math.nan for values in of_best
    )
    return {
        "best_f1": best_f1,
        "best_step": best_step,
        "best_seconds": best_seconds,
        "last_f1": last_f1,
        "step": step,
        "seconds": seconds,
        "updates": _last(run, "updates"),
        "rate": step / seconds if seconds else math.nan,
    }


# Numbers in words


def _ratio(value: float) -> str:
    return f"{value:.3f}"


def _count(value: float) -> str:
    size = abs(float(f"{value:.4g}"))
    unit, name = (1e6, " M") if size >= 1e6 else (1e3, " k") if size >= 1e4 else (1, "")
    return f"{value / unit:z,.4g}{name}".replace("-", "−")


def _time(seconds: float) -> str:
    if round(seconds) < 2 * _MINUTE:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / _MINUTE), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


_FIGURES: dict[str, tuple[str, Callable[[float], str]]] = {
    "best_f1": ("Best F1", _ratio),
    "best_step": ("at step", _count),
    "best_seconds": ("after", _time),
    "last_f1": ("Last F1", _ratio),
    "step": ("Control steps", _count),
    "seconds": ("Wall time", _time),
    "updates": ("Updates", _count),
    "rate": ("Steps a second", _count),
}
"""Figures of a run -> what they are called, and how they are written."""


def _shown(name: str, value: float) -> str:
    return "–" if math.isnan(value) else _FIGURES[name][1](value)


def _about(runs: Sequence[Curve], links: Mapping[str, str]) -> str:
    evaluations = sum(len(_points(run, "eval/f1").x) for run in runs)
    whose = ("runs", str(len(runs))) if len(runs) > 1 else ("run", html.escape(runs[0].name))
    facts = (whose, ("evaluations", str(evaluations)))
    shown = [f"<span>{name} <b>{value}</b></span>" for name, value in facts]
    shown += [
        f'<a href="{html.escape(address)}">{html.escape(label)}</a>'
        for label, address in links.items()
    ]
    return "".join(shown)


def _cards(figures: Mapping[str, float]) -> str:
    cards = []
    for name in ("best_f1", "last_f1", "step", "seconds", "updates", "rate"):
        shown, more = _shown(name, figures[name]), ""
        if name.endswith("f1") and not math.isnan(figures[name]):
            more = f'<div class="bar"><i style="width:{100 * figures[name]:.1f}%"></i></div>'
        if name == "best_f1" and more:
            step, seconds = (_shown(part, figures[part]) for part in ("best_step", "best_seconds"))
            more += f"<small>at step {step},<br>after {seconds}</small>"
        cards.append(
            f'<dl class="score"><dt>{_FIGURES[name][0]}</dt><dd>{shown}</dd>{more}</dl>'
        )
    return f'<section class="scores" aria-label="Figures">{"".join(cards)}</section>'


def _table(runs: Sequence[Curve]) -> str:
    """A row a run, and their means."""
    rows = [(html.escape(run.name), _figures(run)) for run in runs]
    known = {name: [f[name] for _, f in rows if not math.isnan(f[name])] for name in _FIGURES}
    rows.append(("mean", {n: math.fsum(v) / len(v) if v else math.nan for n, v in known.items()}))
    head = "".join(f'<th scope="col">{title}</th>' for title, _ in _FIGURES.values())
    body = (
        f'<tr><th scope="row">{title}</th>'
        + "".join(f"<td>{_shown(name, figures[name])}</td>" for name in _FIGURES)
        + "</tr>"
        for title, figures in rows
    )
    return (
        '<section class="card" aria-label="Figures"><div class="scroll figures" tabindex="0">'
        f"<table><thead><tr><td></td>{head}</tr></thead><tbody>{''.join(body)}</tbody></table>"
        "</div></section>"
    )


def _settings(settings: Mapping[str, Any]) -> str:
    """A section to unfold, nothing if there are none."""
    rows = "".join(
        f'<tr><th scope="row">{html.escape(name)}</th><td>{html.escape(str(value))}</td></tr>'
        for name, value in _flat(settings)
        if value is not None
    )
    table = f'<div class="scroll"><table>{rows}</table></div>'
    opened = f"<details><summary><h2>Settings</h2></summary>{table}</details>"
    return f'<section class="card">{opened}</section>' if rows else ""


def _flat(mapping: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in mapping.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


# Charts


def _playing(runs: Sequence[Curve]) -> str:
    """F1 with precision and recall, against control steps and against wall time."""
    several = len(runs) > 1
    columns = {
        name: [_points(run, f"eval/{name}") for run in runs] for name in ("f1", "precision", "recall")
    }
    if not any(len(points.x) for points in columns["f1"]):
        return '<p class="none">No evaluation yet.</p>'
    ratio = _Axis(0, 1, {tick / 5: f"{tick / 5:g}" for tick in range(6)})

    def chart(title: str, unit: str, axis: _Axis, timed: bool) -> str:
        on = {
            name: [
                _Points(_seconds(run, points.x), points.y) if timed else points
                for run, points in zip(runs, each, strict=True)
            ]
            for name, each in columns.items()
        }
        best = max(
            (_Points(p.x[[i]], p.y[[i]]) for p in on["f1"] if len(p.y) for i in [p.y.argmax()]),
            key=lambda points: points.y[0],
        )
        most = _most_points(runs)
        lines = [
            _Line(name, name, _thinned(_mean(on[name]), most)) for name in ("precision", "recall")
        ]
        lines += _lines(runs, [_thinned(points, most) for points in on["f1"]])
        marks = [_Line("best", f"best: {best.y[0]:.3f}", best)]
        return _chart(title, unit, axis, ratio, lines, marks)

    ...
