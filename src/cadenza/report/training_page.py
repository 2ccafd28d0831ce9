"""The page of learning curves of training runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.report.charts import (
    MAX_VALUE,
    SCRIPTS,
    STYLES,
    Line,
    LineChart,
    Points,
    compact_number,
    duration_text,
    fixed_number,
    line_chart,
    line_style,
    mean_of_known,
)
from cadenza.report.html_pages import render
from cadenza.report.performance_page import settings_table

_REWARDS = "eval/reward/"
_TITLES = {
    "eval/return": "Return",
    _REWARDS: "Reward: ",
    "episodes/f1": "F1 of training episodes",
    "episodes/return": "Return of training episodes",
    "train/critic_loss": "Critic loss",
    "train/actor_loss": "Actor loss",
    "train/policy_loss": "Policy loss",
    "train/value_loss": "Value loss",
    "train/value": "Value",
    "train/entropy": "Entropy",
    "train/temperature": "Temperature",
    "train/kl": "Divergence of the policy in an update",
    "train/learning_rate": "Learning rate",
}
"""Columns -> titles of their charts; each term of the reward has one."""
_UNITS: dict[str, Literal["number", "share", "log"]] = {
    "episodes/f1": "share",
    "train/critic_loss": "log",
    "train/value_loss": "log",
    "train/temperature": "log",
    "train/learning_rate": "log",
}
"""Columns -> what their axes measure, if not just numbers."""
_MEAN = "mean"  # style and name of the line of all runs
_MAX_POINTS = 1200  # of all runs together in a chart, so that the page stays small
_MAX_LINE_POINTS = 200  # of a line: more are not to be seen


@dataclass(frozen=True)
class Curve:
    """A training run."""

    name: str
    rows: Sequence[Mapping[str, float | None]]
    """Oldest first, each with `step` in control steps, and `seconds` of training until then.

    The row of an evaluation has `eval_step`, the step its policy is of, and columns `eval/...`;
    others have `updates`, `train/...` and `episodes/...`. Any but `step` and `seconds` may be
    missing.
    """
    task: str = ""
    """Song and settings; runs that differ in it are not drawn as one."""
    num_steps: float = math.nan
    """Control steps that it is to make, if that is known."""


def training_page(
    title: str,
    runs: Sequence[Curve],
    settings: Mapping[str, Any],
    links: Mapping[str, str] = MappingProxyType({}),
    running: bool = False,
) -> Iterator[str]:
    """Yields the page of learning curves piece by piece.

    Runs of one task have a line each, and one of their mean. Where there are several tasks, each
    has the line of its mean, over a band from its lowest run to its highest.

    Args:
        title: what was learnt.
        runs: at least one.
        settings: name -> value, nested or not. None is not shown.
        links: label -> relative address of another page.
        running: whether the page is to load itself anew from time to time.
    """
    several, styles = len(runs) > 1, [(style, name) for style, name, _ in _series(runs)]
    details = [] if len(_tasks(runs)) > 1 else _detail_styles(several)
    evaluations = sum(len(_points(run, "eval/f1").x) for run in runs)
    return render(
        "training.html",
        title=title,
        facts={
            "runs" if several else "run": str(len(runs)) if several else runs[0].name,
            "evaluations": str(evaluations),
        },
        links=links,
        cards=[] if several else _cards(runs[0]),
        columns=[column.title for column in _COLUMNS.values()],
        rows=_table(runs),
        f1_charts=_f1_charts(runs),
        f1_legend=[*styles, *details],
        other_charts=_other_charts(runs),
        other_legend=styles if several else [],
        settings=settings_table(settings),
        running=running,
        styles=STYLES,
        scripts=(*SCRIPTS, "training.js"),
    )


# The rows of a run


def _tasks(runs: Sequence[Curve]) -> dict[str, list[Curve]]:
    """Returns the runs of each task, in order."""
    tasks = dict.fromkeys(run.task for run in runs)
    return {task: [run for run in runs if run.task == task] for task in tasks}


def _points(run: Curve, column: str, above: float = -MAX_VALUE) -> Points:
    """Returns the values of a column that can be drawn and lie `above`, by control steps."""
    found = [
        (row.get("eval_step", row["step"]), row[column])
        for row in run.rows
        if row.get(column) is not None
    ]
    x, y = np.array(found, float).reshape(-1, 2).T
    return _drawable(x, y, above)


def _drawable(x: NDArray[np.float64], y: NDArray[np.float64], above: float = -MAX_VALUE) -> Points:
    drawable = (y > above) & (y < MAX_VALUE) & (x < MAX_VALUE)
    return Points(x[drawable], y[drawable])


def _seconds(run: Curve, steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the wall time [s] at which training had done `steps` (n,).

    An evaluation's own row is no help: it is written when training has long gone on.
    """
    known = [(0, 0), *((row["step"], row["seconds"]) for row in run.rows)]
    return np.interp(steps, *np.array(known, float).T)


def _by_time(run: Curve, points: Points) -> Points:
    return _drawable(_seconds(run, points.x), points.y)


def _mean(each: Sequence[Points]) -> Points:
    """Returns the mean of the lines that have points, over the range that all of these cover."""
    x, values = _resampled(each)
    return Points(x, values.mean(axis=0))


def _resampled(each: Sequence[Points]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns x (n,) where all lines that have points are, and their values (lines, n) there."""
    each = [points for points in each if len(points.x)]
    x = np.unique(np.concatenate([np.empty(0), *(points.x for points in each)]))
    for points in each:
        x = x[(points.x[0] <= x) & (x <= points.x[-1])]
    return x, np.array([np.interp(x, *points) for points in each] or [x])


def _thinned(points: Points, runs: Sequence[Curve]) -> Points:
    """Returns means over neighbours, as few as the page has room for."""
    most = min(_MAX_LINE_POINTS, max(_MAX_POINTS // len(runs), 2))
    if len(points.x) <= most:
        return points
    first = np.linspace(0, len(points.x), most, endpoint=False).astype(int)
    size = np.diff(first, append=len(points.x))
    return Points(*(np.add.reduceat(values, first) / size for values in points))


def _last(run: Curve, column: str) -> float:
    values = (row.get(column) for row in reversed(run.rows))
    return next((value for value in values if value is not None), math.nan)


def _seconds_left(run: Curve, steps_left: float) -> float:
    """Returns the time [s] at the rate of the run's second half; NaN where there is none yet."""
    known = [(row["step"], row["seconds"]) for row in run.rows[len(run.rows) // 2 :]]
    if not known:
        return math.nan
    steps, seconds = np.ptp(np.array(known, float), axis=0)
    return float(steps_left * seconds / steps) if steps else math.nan


# Numbers


class _Column(NamedTuple):
    title: str
    text: Callable[[float], str]
    is_share: bool = False


def _share(title: str) -> _Column:
    return _Column(title, lambda value: fixed_number(value, 3), is_share=True)


_COLUMNS = {
    "best_f1": _share("Best F1"),
    "best_onsets": _share("Note onset F1 then"),
    "best_step": _Column("at step", compact_number),
    "best_seconds": _Column("after", duration_text),
    "last_f1": _share("Last F1"),
    "last_onsets": _share("Last note onset F1"),
    "step": _Column("Control steps", compact_number),
    "seconds": _Column("Wall time", duration_text),
    "updates": _Column("Updates", compact_number),
    "rate": _Column("Steps per second", compact_number),
}
"""Numbers that sum up a run."""


def _summary(run: Curve) -> dict[str, float]:
    """Returns the value of each of `_COLUMNS`; NaN where it is not known."""
    summary = {name: _last(run, name) for name in ("step", "seconds", "updates")}
    summary["rate"] = summary["step"] / (summary["seconds"] or math.nan)
    steps, f1 = _points(run, "eval/f1")
    if not len(f1):
        return dict.fromkeys(_COLUMNS, math.nan) | summary
    best = f1.argmax()
    onsets = {row.get("eval_step"): row.get("eval/note_onset_f1") for row in run.rows}
    at_best, last = (onsets.get(float(steps[i])) for i in (best, -1))
    return summary | {
        "best_f1": float(f1[best]),
        "best_onsets": math.nan if at_best is None else at_best,
        "best_step": float(steps[best]),
        "best_seconds": float(_seconds(run, steps)[best]),
        "last_f1": float(f1[-1]),
        "last_onsets": math.nan if last is None else last,
    }


def _text(name: str, summary: Mapping[str, float]) -> str:
    return "–" if math.isnan(summary[name]) else _COLUMNS[name].text(summary[name])


def _cards(run: Curve) -> list[dict[str, Any]]:
    """Returns title, text, share and lines below of each card of a single run."""
    summary, below = _summary(run), _remaining(run)
    if not math.isnan(summary["best_f1"]):
        step, seconds = _text("best_step", summary), _text("best_seconds", summary)
        below["best_f1"] = [f"at step {step},", f"after {seconds}"]
    return [
        {
            "title": column.title,
            "text": _text(name, summary),
            "share": summary[name] if column.is_share else None,
            "below": below.get(name, []),
        }
        for name, column in _COLUMNS.items()
        if name not in ("best_step", "best_seconds")  # which stand below the best F1
    ]


def _remaining(run: Curve) -> dict[str, list[str]]:
    """Returns what is still to be done by a run that is not finished."""
    steps = run.num_steps - (_last(run, "step") if run.rows else 0)
    if not steps > 0:
        return {}
    below = {"step": [f"{compact_number(steps)} to go", f"of {compact_number(run.num_steps)}"]}
    seconds = _seconds_left(run, steps)
    if math.isnan(seconds):
        return below
    return below | {"seconds": [f"about {duration_text(seconds)}", "left"]}


def _table(runs: Sequence[Curve]) -> list[tuple[str, str, list[str]]]:
    """Returns kind, name and cells of a row for each run, and for the mean of several of a task."""
    rows, tasks = list[tuple[str, str, list[str]]](), _tasks(runs)
    for task, task_runs in tasks.items():
        summaries = [_summary(run) for run in task_runs]
        rows += [
            ("run", run.name, [_text(name, summary) for name in _COLUMNS])
            for run, summary in zip(task_runs, summaries, strict=True)
        ]
        if len(task_runs) > 1:
            means = {n: mean_of_known([summary[n] for summary in summaries]) for n in _COLUMNS}
            name = f"mean of {task}" if len(tasks) > 1 else "mean"
            rows.append(("mean", name, [_text(name, means) for name in _COLUMNS]))
    return rows


# Charts


def _f1_charts(runs: Sequence[Curve]) -> list[LineChart]:
    """Returns F1 with precision and recall, and note onset F1, by control steps and wall time."""
    by_step = {
        name: [_points(run, f"eval/{name}") for run in runs]
        for name in ("f1", "precision", "recall", "note_onset_f1")
    }
    by_time = {name: list(map(_by_time, runs, each)) for name, each in by_step.items()}
    axes: tuple[tuple[str, str, Mapping[str, list[Points]], Literal["number", "seconds"]], ...] = (
        ("control steps", "step", by_step, "number"),
        ("wall time", "seconds", by_time, "seconds"),
    )
    return [
        line_chart(f"{title} by {label}", label, _end(runs, column), lines, unit, "share")
        for label, column, points, unit in axes
        if any(len(f1.x) for f1 in points["f1"])
        for title, lines in (
            ("F1", _f1_lines(runs, points)),
            ("Note onset F1", _lines(runs, points["note_onset_f1"])),
        )
        if lines
    ]


def _f1_lines(runs: Sequence[Curve], columns: Mapping[str, Sequence[Points]]) -> list[Line]:
    """Returns the lines of F1; of one task, those of precision and recall and the best, too."""
    if len(_tasks(runs)) > 1:
        return _lines(runs, columns["f1"])
    lighter = [
        Line(name, name, _thinned(_mean(columns[name]), runs)) for name in ("precision", "recall")
    ]
    x, y = (np.concatenate(values) for values in zip(*columns["f1"], strict=True))
    best = Points(x[[y.argmax()]], y[[y.argmax()]])
    return [*lighter, *_lines(runs, columns["f1"]), Line("best", "best", best)]


def _other_charts(runs: Sequence[Curve]) -> list[LineChart]:
    """Returns a chart of each other column that has values, by control steps."""
    charts = []
    for column, title in _titles(runs):
        unit = _UNITS.get(column, "number")
        above = 1 / MAX_VALUE if unit == "log" else -MAX_VALUE
        if lines := _lines(runs, [_points(run, column, above) for run in runs]):
            end = _end(runs, "step")
            charts.append(line_chart(title, "control steps", end, lines, y_unit=unit))
    return charts


def _titles(runs: Sequence[Curve]) -> Iterator[tuple[str, str]]:
    """Yields columns, and titles of their charts."""
    columns = sorted({name for run in runs for row in run.rows for name in row})
    for column, title in _TITLES.items():
        if column == _REWARDS:
            terms = [name.removeprefix(_REWARDS) for name in columns if name.startswith(_REWARDS)]
            yield from ((_REWARDS + term, title + term.replace("_", " ")) for term in terms)
        else:
            yield column, title


def _lines(runs: Sequence[Curve], each: Sequence[Points]) -> list[Line]:
    """Returns the lines of `_series`, but for a mean of fewer than two; none without any points."""
    num_known = sum(len(points.x) > 0 for points in each)
    return [
        _line(style, name, [each[i] for i in members], runs)
        for style, name, members in _series(runs)
        if num_known > 1 or (num_known and style != _MEAN)
    ]


def _line(style: str, name: str, each: Sequence[Points], runs: Sequence[Curve]) -> Line:
    """Returns the mean of lines, for several of a task over a band from lowest to highest."""
    x, values = _resampled(each)
    mean, low, high = (
        _thinned(Points(x, y), runs) for y in (values.mean(0), values.min(0), values.max(0))
    )
    return Line(style, name, mean, (low.y, high.y) if len(values) > 1 and style != _MEAN else None)


def _series(runs: Sequence[Curve]) -> list[tuple[str, str, list[int]]]:
    """Returns style, name and runs of each line: of a run each and of all, or of a task each."""
    numbers, tasks = list(range(len(runs))), _tasks(runs)
    if len(tasks) > 1:
        return [
            (line_style(i), task, [n for n in numbers if runs[n].task == task])
            for i, task in enumerate(tasks)
        ]
    each = [(line_style(n), runs[n].name, [n]) for n in numbers]
    return each + [(_MEAN, _MEAN, numbers)] * (len(runs) > 1)


def _detail_styles(several: bool) -> list[tuple[str, str]]:
    mean = "mean " if several else ""
    return [("precision", f"{mean}precision"), ("recall", f"{mean}recall"), ("best", "best")]


def _end(runs: Sequence[Curve], column: str) -> float:
    """Returns where the longest of the runs ended, 1 where there is nothing yet."""
    ends = [row[column] or 0 for run in runs for row in run.rows[-1:]]
    return max((end for end in ends if end < MAX_VALUE), default=0) or 1
