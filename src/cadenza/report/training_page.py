"""Figures of training runs: the page of learning curves, TensorBoard, and Weights & Biases."""

import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import extra_packages
from cadenza.report.html_pages import render
from cadenza.report.performance_page import settings_table

_SCORES = {"eval/f1": "F1", "eval/note_onset_f1": "Note onset F1"}
_OTHERS = {
    "eval/return": "Return",
    "episodes/note_onset_f1": "Note onset F1 of training episodes",
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
"""Columns -> titles of their charts, the small ones below the scores."""
_UNITS = {
    **dict.fromkeys((*_SCORES, "episodes/f1", "episodes/note_onset_f1"), "share"),
    "train/critic_loss": "log",
    "train/value_loss": "log",
    "train/temperature": "log",
    "train/learning_rate": "log",
}
"""Columns -> kinds of their axes, if not just numbers; a share is drawn from 0 to 1."""
_MAX_VALUE = 1e30  # greatest drawn value; uPlot has no ticks beyond
_NUM_COLOURS = 8  # colours of the style sheet
_DIGITS = 6  # significant, of a value that is drawn
_MEAN = "mean"  # style and name of the line of all runs
_MAX_POINTS = 1200  # points of all runs in a chart: the page stays small
_MAX_LINE_POINTS = 200  # points of a line; more cannot be seen


class Points(NamedTuple):
    """Points of a line, each (n,)."""

    x: NDArray[np.float64]
    y: NDArray[np.float64]


class LineChart(NamedTuple):
    """A chart of lines as the template takes it."""

    title: str
    description: str  # a sentence that stands for the picture
    data: dict[str, Any]  # the input of `curves.js`


@dataclass(frozen=True)
class Curve:
    """A training run."""

    name: str
    # Oldest first, each with `step` in control steps. The row of an evaluation has `eval_step`, the
    # step of the policy that was evaluated, and columns `eval/...`; others have `train/...` and
    # `episodes/...`. Any but `step` may be missing.
    rows: Sequence[Mapping[str, float | None]]
    task: str = ""  # song and settings; runs that differ in it are not drawn as one


def training_page(
    title: str,
    runs: Sequence[Curve],
    settings: Mapping[str, Any],
    links: Mapping[str, str] = MappingProxyType({}),
    running: bool = False,
) -> Iterator[str]:
    """Yield the page of learning curves piece by piece.

    Runs of one task have a line each, and one of their mean. Where there are several tasks, each
    has the line of its mean, over a band from its lowest run to its highest.

    Args:
        title: what was learnt.
        runs: at least one.
        settings: name -> value, nested or not. None is not shown.
        links: label -> relative address of another page.
        running: whether the page is to load itself anew from time to time.
    """
    several = len(runs) > 1
    evaluations = sum(len(_points(run, "eval/f1").x) for run in runs)
    return render(
        "training.html",
        title=title,
        facts={
            "runs" if several else "run": str(len(runs)) if several else runs[0].name,
            "evaluations": str(evaluations),
        },
        links=links,
        legend=[(style, name) for style, name, _ in _series(runs)] if several else [],
        scores=_charts(runs, _SCORES),
        others=_charts(runs, _OTHERS),
        settings=settings_table(settings),
        running=running,
        styles=("uplot.min.css", "page.css", "chart.css", "training.css"),
        scripts=("elements.js", "chart.js", "curves.js"),
    )


def _charts(runs: Sequence[Curve], titles: Mapping[str, str]) -> list[LineChart]:
    """A chart of each column that has values, by control steps."""
    charts = []
    for column, title in titles.items():
        unit = _UNITS.get(column, "number")
        above = 1 / _MAX_VALUE if unit == "log" else -_MAX_VALUE
        if lines := _lines(runs, [_points(run, column, above) for run in runs]):
            ends = (f"{line['name']} ends at {line['y'][-1]:.4g}" for line in lines)
            description = f"{title} by control steps: {', '.join(ends)}"
            data = {"end": _end(runs), "y": unit, "lines": lines}
            charts.append(LineChart(title, description, data))
    return charts


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]


def _end(runs: Sequence[Curve]) -> float:
    """The step at which the longest of the runs ended, 1 where there is nothing yet."""
    ends = [row["step"] or 0 for run in runs for row in run.rows[-1:]]
    return max((end for end in ends if end < _MAX_VALUE), default=0) or 1


def _points(run: Curve, column: str, above: float = -_MAX_VALUE) -> Points:
    """The values of a column that can be drawn and lie `above`, by control steps."""
    values = [
        (row.get("eval_step", row["step"]), row[column])
        for row in run.rows
        if row.get(column) is not None
    ]
    x, y = np.array(values, float).reshape(-1, 2).T
    drawable = (y > above) & (y < _MAX_VALUE) & (x < _MAX_VALUE)
    return Points(x[drawable], y[drawable])


def _resampled(lines: Sequence[Points]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """X (n,) where all lines that have points are, and their values (lines, n) there."""
    lines = [points for points in lines if len(points.x)]
    x = np.unique(np.concatenate([np.empty(0), *(points.x for points in lines)]))
    for points in lines:
        x = x[(points.x[0] <= x) & (x <= points.x[-1])]
    return x, np.array([np.interp(x, *points) for points in lines] or [x])


def _thinned(points: Points, runs: Sequence[Curve]) -> Points:
    """Means over neighbours, as few as the page has room for."""
    max_points = min(_MAX_LINE_POINTS, max(_MAX_POINTS // len(runs), 2))
    if len(points.x) <= max_points:
        return points
    first = np.linspace(0, len(points.x), max_points, endpoint=False).astype(int)
    size = np.diff(first, append=len(points.x))
    return Points(*(np.add.reduceat(values, first) / size for values in points))


def _lines(runs: Sequence[Curve], points_of_runs: Sequence[Points]) -> list[dict[str, Any]]:
    """The lines of `_series` that have points, without a mean of fewer than two runs."""
    num_lines = sum(len(points.x) > 0 for points in points_of_runs)
    lines = [
        _line(style, name, [points_of_runs[i] for i in members], runs)
        for style, name, members in _series(runs)
        if num_lines > 1 or style != _MEAN
    ]
    return [line for line in lines if line["x"]]


def _line(
    style: str, name: str, points_of_runs: Sequence[Points], runs: Sequence[Curve]
) -> dict[str, Any]:
    """The mean of lines, for several of a task over a band from lowest to highest."""
    x, values = _resampled(points_of_runs)
    mean, low, high = (
        _thinned(Points(x, y), runs) for y in (values.mean(0), values.min(0), values.max(0))
    )
    line = {"kind": style, "name": name, "x": _rounded(mean.x), "y": _rounded(mean.y)}
    if len(values) > 1 and style != _MEAN:
        line["band"] = [_rounded(low.y), _rounded(high.y)]
    return line


def _series(runs: Sequence[Curve]) -> list[tuple[str, str, list[int]]]:
    """Style, name and runs of each line: of a run each and of all, or of a task each."""
    tasks: dict[str, list[int]] = {}
    for i, run in enumerate(runs):
        tasks.setdefault(run.task, []).append(i)
    if len(tasks) > 1:
        return [(_style(i), task, tasks[task]) for i, task in enumerate(tasks)]
    numbers = list(range(len(runs)))
    series = [(_style(n), runs[n].name, [n]) for n in numbers]
    return series + [(_MEAN, _MEAN, numbers)] * (len(runs) > 1)


def _style(number: int) -> str:
    """The class in the style sheet of the `number`th line, from 0 on."""
    return f"run{number % _NUM_COLOURS}"


# Logs, row by row; the step of a row is `eval_step`, or else `step`.


class TensorBoard:
    """Event files of TensorBoard in a folder."""

    def __init__(self, folder: Path, step: int) -> None:
        """Resume at `step`, and hide later ones; raises CadenzaError without tensorboardX."""
        with extra_packages("train", "training"):
            from tensorboardX import SummaryWriter
        # An unpredictable name, as the file is opened through links.
        suffix = f".{secrets.token_hex(4)}"
        self._writer = SummaryWriter(str(folder), purge_step=step or None, filename_suffix=suffix)

    def add(self, row: Mapping[str, float]) -> None:
        for name, value in _metrics(row).items():
            self._writer.add_scalar(name, value, _step(row))

    def close(self) -> None:
        self._writer.close()


def need_wandb() -> Any:
    """Import the package wandb. Raises CadenzaError if it is not installed."""
    with extra_packages("wandb", "--wandb"):
        import wandb
    return wandb


class WeightsAndBiases:
    """A run on wandb.ai, or wherever its environment variables say."""

    def __init__(self, project: str, folder: Path, run: str, settings: Mapping[str, Any]) -> None:
        """Resume the run of that id in the project, if any; wandb keeps files in the folder.

        Raises CadenzaError if wandb is not installed.
        """
        self._run = need_wandb().init(
            project=project, dir=str(folder), id=run, resume="allow", config=dict(settings)
        )

    def add(self, row: Mapping[str, float]) -> None:
        self._run.log({**_metrics(row), "control_steps": _step(row)})

    def close(self) -> None:
        self._run.finish()


def _step(row: Mapping[str, float]) -> int:
    return int(row.get("eval_step", row["step"]))


def _metrics(row: Mapping[str, float]) -> dict[str, float]:
    return {n: v for n, v in row.items() if n not in ("step", "eval_step")}
