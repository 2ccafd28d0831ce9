"""Learning curves of training runs as one HTML file: no network, no server."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from cadenza.report.asset import asset
from cadenza.report.line_chart import (
    LARGEST,
    STYLES,
    Line,
    Points,
    coloured,
    in_short,
    in_time,
    legend,
    line_chart,
)
from cadenza.report.page import settings_section, write_page

_REWARDS = "eval/reward/"
_TITLES = {
    "eval/return": "Return",
    _REWARDS: "Reward: ",
    "episodes/f1": "F1 of training episodes",
    "episodes/return": "Return of training episodes",
    "train/critic_loss": "Critic loss",
    "train/actor_loss": "Actor loss",
    "train/value": "Value",
    "train/entropy": "Entropy",
    "train/temperature": "Temperature",
}
"""Columns -> titles of their charts; each term of the reward has one."""
_KINDS: dict[str, Literal["number", "share", "log"]] = {
    "episodes/f1": "share",
    "train/critic_loss": "log",
    "train/temperature": "log",
}
"""Columns -> what their axes measure, if not just numbers."""
_DRAWN = 1200  # points of all runs together in a chart, so that the page stays small
_MOST_DRAWN = 200  # points of a line: more are not to be seen


@dataclass(frozen=True)
class Curve:
    """What is known of one training run."""

    name: str
    rows: Sequence[Mapping[str, float | None]]
    """Oldest first, each with `step` in control steps, and `seconds` of training until then.

    That of an evaluation has `eval_step`, the step its policy is of, and columns `eval/...`; others
    have `updates`, `train/...` and `episodes/...`. Any but `step` and `seconds` may be missing.
    """
    task: str = ""
    """What it learns, and how; runs that differ in it are not drawn as one."""
    num_steps: float = math.nan
    """Control steps that it is to make, if that is known."""


def write_training(
    path: Path,
    title: str,
    runs: Sequence[Curve],
    settings: Mapping[str, Any],
    links: Mapping[str, str] = MappingProxyType({}),
    going_on: bool = False,
) -> None:
    """Writes the page of learning curves to `path`.

    Runs of one task have a line each, and one of their mean. Where there are several tasks, each
    has the line of its mean, over a band from its lowest run to its highest.

    Args:
        path: of the file.
        title: what was learnt.
        runs: at least one.
        settings: name -> value, nested or not. None is not shown.
        links: label -> relative address of another page.
        going_on: whether the page is to load itself anew from time to time.
    """
    parts = {
        "title": html.escape(title),
        "facts": _facts(runs),
        "links": _links(links),
        "headline": _table(runs) if len(runs) > 1 else _cards(runs[0]),
        "f1": _f1_section(runs),
        "others": _other_section(runs),
        "settings": settings_section(settings),
        "renewed": " data-renewed" if going_on else "",
        "uplot": asset("uplot.min.js"),
        "css": "".join(map(asset, STYLES)),
        "js": "".join(map(asset, ("chart.js", "curves.js", "training.js"))),
    }
    write_page(path, "training.html", parts)


# What the rows tell


def _tasks(runs: Sequence[Curve]) -> dict[str, list[Curve]]:
    """Those of each task, in order."""
    tasks = dict.fromkeys(run.task for run in runs)
    return {task: [run for run in runs if run.task == task] for task in tasks}


def _points(run: Curve, column: str, above: float = -LARGEST) -> Points:
    """A column against control steps, without the rows that do not have it `above` and drawable."""
    found = [
        (row.get("eval_step", row["step"]), row[column])
        for row in run.rows
        if row.get(column) is not None
    ]
    x, y = np.array(found, float).reshape(-1, 2).T
    return _drawable(x, y, above)


def _drawable(x: NDArray[np.float64], y: NDArray[np.float64], above: float = -LARGEST) -> Points:
    drawable = (y > above) & (y < LARGEST) & (x < LARGEST)
    return Points(x[drawable], y[drawable])


def _seconds(run: Curve, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Wall time [s] at which training had done `steps` (n,).

    An evaluation's own row is no help: it is written when training has long gone on.
    """
    known = [(0, 0), *((row["step"], row["seconds"]) for row in run.rows)]
    return np.interp(steps, *np.array(known, float).T)


def _timed(run: Curve, points: Points) -> Points:
    return _drawable(_seconds(run, points.x), points.y)


def _mean(each: Sequence[Points]) -> Points:
    """The mean of the lines that have points, over the range that all of these cover."""
    x, values = _together(each)
    return Points(x, values.mean(axis=0))


def _together(each: Sequence[Points]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """x (n,) where all lines that have points are, and their values (lines, n) there."""
    each = [points for points in each if len(points.x)]
    x = np.unique(np.concatenate([np.empty(0), *(points.x for points in each)]))
    for points in each:
        x = x[(points.x[0] <= x) & (x <= points.x[-1])]
    return x, np.array([np.interp(x, *points) for points in each] or [x])


def _thinned(points: Points, runs: Sequence[Curve]) -> Points:
    """Means over neighbours, as few as the page has room for."""
    most = min(_MOST_DRAWN, max(_DRAWN // len(runs), 2))
    if len(points.x) <= most:
        return points
    first = np.linspace(0, len(points.x), most, endpoint=False).astype(int)
    size = np.diff(first, append=len(points.x))
    return Points(*(np.add.reduceat(values, first) / size for values in points))


def _last(run: Curve, column: str) -> float:
    values = (row.get(column) for row in reversed(run.rows))
    return next((value for value in values if value is not None), math.nan)


def _seconds_left(run: Curve, to_do: float) -> float:
    """[s] for so many steps at the rate of the run's second half; NaN where there is none yet."""
    known = [(row["step"], row["seconds"]) for row in run.rows[len(run.rows) // 2 :]]
    if not known:
        return math.nan
    steps, seconds = np.ptp(np.array(known, float), axis=0)
    return float(to_do * seconds / steps) if steps else math.nan


def _figures(run: Curve) -> dict[str, float]:
    """Those of `_FIGURES`; NaN where one is not known."""
    figures = {name: _last(run, name) for name in ("step", "seconds", "updates")}
    figures["rate"] = figures["step"] / (figures["seconds"] or math.nan)
    steps, f1 = _points(run, "eval/f1")
    if not len(f1):
        return dict.fromkeys(_FIGURES, math.nan) | figures
    best = f1.argmax()
    onsets = {row.get("eval_step"): row.get("eval/note_onset_f1") for row in run.rows}
    at_best, last = (onsets.get(float(steps[i])) for i in (best, -1))
    return figures | {
        "best_f1": float(f1[best]),
        "best_onsets": math.nan if at_best is None else at_best,
        "best_step": float(steps[best]),
        "best_seconds": float(_seconds(run, steps)[best]),
        "last_f1": float(f1[-1]),
        "last_onsets": math.nan if last is None else last,
    }


# In words and figures


def _ratio(value: float) -> str:
    return f"{value:.3f}"


_FIGURES: dict[str, tuple[str, Callable[[float], str]]] = {
    "best_f1": ("Best F1", _ratio),
    "best_onsets": ("Note onsets then", _ratio),
    "best_step": ("at step", in_short),
    "best_seconds": ("after", in_time),
    "last_f1": ("Last F1", _ratio),
    "last_onsets": ("Last note onsets", _ratio),
    "step": ("Control steps", in_short),
    "seconds": ("Wall time", in_time),
    "updates": ("Updates", in_short),
    "rate": ("Steps a second", in_short),
}
"""Figures of a run -> what they are called, and how they are written."""
_SHARES = ("best_f1", "best_onsets", "last_f1", "last_onsets")


def _shown(name: str, figures: Mapping[str, float]) -> str:
    return "–" if math.isnan(figures[name]) else _FIGURES[name][1](figures[name])


def _facts(runs: Sequence[Curve]) -> str:
    evaluations = sum(len(_points(run, "eval/f1").x) for run in runs)
    facts = {
        "run" if len(runs) == 1 else "runs": runs[0].name if len(runs) == 1 else str(len(runs)),
        "evaluations": str(evaluations),
    }
    return "".join(f"<span>{k} <b>{html.escape(v)}</b></span>" for k, v in facts.items())


def _links(links: Mapping[str, str]) -> str:
    return "".join(
        f'<a href="{html.escape(address)}">{html.escape(label)}</a>'
        for label, address in links.items()
    )


def _cards(run: Curve) -> str:
    cards, figures = [], _figures(run)
    more = _to_do(run)
    if not math.isnan(figures["best_f1"]):
        step, seconds = _shown("best_step", figures), _shown("best_seconds", figures)
        more["best_f1"] = f"at step {step},<br>after {seconds}"
    for name in (*_SHARES, "step", "seconds", "updates", "rate"):
        bar = ""
        if name in _SHARES and not math.isnan(figures[name]):
            bar = f'<div class="bar"><i style="width:{100 * figures[name]:.1f}%"></i></div>'
        small = f"<small>{more[name]}</small>" if name in more else ""
        title, shown = _FIGURES[name][0], _shown(name, figures)
        cards.append(f'<dl class="score"><dt>{title}</dt><dd>{shown}</dd>{bar}{small}</dl>')
    return f'<section class="scores" aria-label="Figures">{"".join(cards)}</section>'


def _to_do(run: Curve) -> dict[str, str]:
    """Under the figures of a run that is not finished: how much there is to be done."""
    to_do = run.num_steps - (_last(run, "step") if run.rows else 0)
    if not to_do > 0:
        return {}
    more = {"step": f"{in_short(to_do)} to go<br>of {in_short(run.num_steps)}"}
    left = _seconds_left(run, to_do)
    return more if math.isnan(left) else more | {"seconds": f"about {in_time(left)}<br>left"}


def _table(runs: Sequence[Curve]) -> str:
    """A row a run, and of several runs of a task the means of what is known."""
    head = "".join(f'<th scope="col">{title}</th>' for title, _ in _FIGURES.values())
    rows, tasks = [], _tasks(runs)
    for task, its_runs in tasks.items():
        figures = [_figures(run) for run in its_runs]
        rows += [_row("run", run.name, f) for run, f in zip(its_runs, figures, strict=True)]
        if len(its_runs) > 1:
            known = {n: [f[n] for f in figures if not math.isnan(f[n])] for n in _FIGURES}
            means = {n: math.fsum(v) / len(v) if v else math.nan for n, v in known.items()}
            rows.append(_row("mean", f"mean of {task}" if len(tasks) > 1 else "mean", means))
    return (
        '<section class="card" aria-label="Figures"><div class="scroll figures" tabindex="0">'
        f"<table><thead><tr><td></td>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
        "</div></section>"
    )


def _row(kind: str, name: str, figures: Mapping[str, float]) -> str:
    cells = "".join(f"<td>{_shown(figure, figures)}</td>" for figure in _FIGURES)
    return f'<tr class="{kind}"><th scope="row">{html.escape(name)}</th>{cells}</tr>'


# Charts


def _f1_section(runs: Sequence[Curve]) -> str:
    """F1 with precision and recall, and note onset F1, against control steps and wall time."""
    columns = {
        n: [_points(run, f"eval/{n}") for run in runs]
        for n in ("f1", "precision", "recall", "note_onset_f1")
    }
    if not any(len(points.x) for points in columns["f1"]):
        return _section("How well it plays", "<p>No evaluation yet.</p>")
    timed = {name: list(map(_timed, runs, each)) for name, each in columns.items()}
    charts = []
    axes: tuple[tuple[str, str, Mapping[str, list[Points]], Literal["number", "seconds"]], ...] = (
        ("control steps", "step", columns, "number"),
        ("wall time", "seconds", timed, "seconds"),
    )
    for by, end, of, unit in axes:
        both = {"F1": _f1_lines(runs, of), "Note onset F1": _lines(runs, of["note_onset_f1"])}
        charts += [
            line_chart(f"{title} by {by}", by, _end(runs, end), lines, unit, "share")
            for title, lines in both.items()
            if lines
        ]
    of_all = "mean " if len(runs) > 1 else ""
    more = [("precision", f"{of_all}precision"), ("recall", f"{of_all}recall"), ("best", "best")]
    named = legend([*_marks(runs), *(more if len(_tasks(runs)) == 1 else ())])
    return _section("How well it plays", f'{named}<div class="large">{"".join(charts)}</div>')


def _f1_lines(runs: Sequence[Curve], columns: Mapping[str, Sequence[Points]]) -> list[Line]:
    """Those of one task with precision, recall, and the best."""
    if len(_tasks(runs)) > 1:
        return _lines(runs, columns["f1"])
    lighter = [
        Line(name, name, _thinned(_mean(columns[name]), runs)) for name in ("precision", "recall")
    ]
    x, y = (np.concatenate(values) for values in zip(*columns["f1"], strict=True))
    best = Points(x[[y.argmax()]], y[[y.argmax()]])
    return [*lighter, *_lines(runs, columns["f1"]), Line("best", "best", best)]


def _other_section(runs: Sequence[Curve]) -> str:
    """A small chart of each other column that has values, against control steps."""
    charts = ""
    for column, title in _titles(runs):
        kind = _KINDS.get(column, "number")
        above = 1 / LARGEST if kind == "log" else -LARGEST
        lines = _lines(runs, [_points(run, column, above) for run in runs])
        if lines:
            charts += line_chart(title, "control steps", _end(runs, "step"), lines, y=kind)
    named = legend(_marks(runs)) if len(runs) > 1 else ""
    content = f'{named}<div class="small">{charts}</div>'
    return _section("What it earns and learns", content) if charts else ""


def _titles(runs: Sequence[Curve]) -> Iterator[tuple[str, str]]:
    """Columns, and titles of their charts."""
    columns = sorted({name for run in runs for row in run.rows for name in row})
    for column, title in _TITLES.items():
        if column == _REWARDS:
            terms = [name.removeprefix(_REWARDS) for name in columns if name.startswith(_REWARDS)]
            yield from ((_REWARDS + term, title + term.replace("_", " ")) for term in terms)
        else:
            yield column, title


def _lines(runs: Sequence[Curve], each: Sequence[Points]) -> list[Line]:
    """A line a run, and their mean if several have any points; or a line a task.

    None where there is nothing to draw.
    """
    if not any(len(points.x) for points in each):
        return []
    if len(tasks := _tasks(runs)) > 1:
        points = dict(zip(map(id, runs), each, strict=True))
        members = ([points[id(run)] for run in its_runs] for its_runs in tasks.values())
        return [
            _with_band(kind, name, of_task, runs)
            for (kind, name), of_task in zip(_marks(runs), members, strict=True)
        ]
    lines = [
        Line(kind, name, _thinned(points, runs))
        for (kind, name), points in zip(_marks(runs), each, strict=False)
    ]
    if sum(len(points.x) > 0 for points in each) > 1:
        lines.append(Line("mean", "mean", _thinned(_mean(each), runs)))
    return lines


def _with_band(kind: str, name: str, each: Sequence[Points], runs: Sequence[Curve]) -> Line:
    """The mean of the runs of a task, and from where to where they lie."""
    x, values = _together(each)
    mean, low, high = (
        _thinned(Points(x, y), runs) for y in (values.mean(0), values.min(0), values.max(0))
    )
    band = (low.y, high.y) if len(values) > 1 else None
    return Line(kind, name, mean, band)


def _marks(runs: Sequence[Curve]) -> list[tuple[str, str]]:
    """Class in the style sheet and name of the line of each run and of their mean, or each task."""
    tasks = _tasks(runs)
    names = list(tasks) if len(tasks) > 1 else [run.name for run in runs]
    marks = [(coloured(i), name) for i, name in enumerate(names)]
    return marks + [("mean", "mean")] * (len(tasks) == 1 < len(runs))


def _section(title: str, content: str) -> str:
    return f'<section class="card"><h2>{title}</h2>{content}</section>'


def _end(runs: Sequence[Curve], column: str) -> float:
    """Where the longest of the runs ended, 1 where there is nothing yet."""
    ends = [row[column] or 0 for run in runs for row in run.rows[-1:]]
    return max((end for end in ends if end < LARGEST), default=0) or 1
