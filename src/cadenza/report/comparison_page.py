"""The page that compares several agents at the same song: metrics, what went right when, all runs.

The file grows by about a megabyte for each minute of each run, nearly all of it sound.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cadenza.episode import Episode
from cadenza.music.performance import key_runs, played_in
from cadenza.music.score import is_black, note_name
from cadenza.report import performance_page as performance
from cadenza.report.charts import Bar, fixed_number, mean_of_known
from cadenza.report.html_pages import asset, packed_asset, render
from cadenza.report.recording import VERDICTS, verdict
from cadenza.report.sound import synthesize

COLUMNS = {
    "f1": ("F1", 3),
    "precision": ("Precision", 3),
    "recall": ("Recall", 3),
    "note_onset_f1": ("Note onset F1", 3),
    "timing_error": ("Timing error [ms]", 0),
    "energy": ("Energy [J]", 1),
    "planning": ("Planning time / music", 2),
}
"""Title and number of decimals of each metric that is compared."""
_STYLES = ("uplot.min.css", "page.css", "chart.css", "comparison.css")
_SCRIPTS = ("elements.js", "chart.js", "comparison.js")
_THREE, _UPLOT = performance.LIBRARIES  # this page runs the latter, too, as `comparison.js` knows
_BARS = ("f1", "precision", "recall", "note_onset_f1")
_MS_PER_SECOND = 1000
_MIDDLE_C = 60  # MIDI pitch
_ROW = 7  # [px] height of a key in the piano roll
_MARGIN = 2  # keys that the piano roll has below and above all notes
_NOTE_GAP = 0.15  # control steps between two notes of a key, so that they are told apart


@dataclass(frozen=True)
class Run:
    """An episode of an agent."""

    agent: str
    seed: int
    metrics: Mapping[str, float]
    """Value of each of `COLUMNS`; NaN where one is not defined."""
    episode: Episode

    @property
    def name(self) -> str:
        return f"{self.agent}, seed {self.seed}"


def compared(metrics: Mapping[str, Any], seconds: float) -> dict[str, float]:
    """Returns the metrics that are compared, of all those of a performance of so many seconds."""
    known = {name: metrics.get(name) for name in COLUMNS}
    known["planning"] = metrics["planning_seconds"] / seconds
    return {name: math.nan if value is None else value for name, value in known.items()}


def means(runs: Sequence[Run]) -> dict[str, dict[str, float]]:
    """Returns for each agent the mean of each metric over the runs in which it is defined."""
    agents = dict.fromkeys(run.agent for run in runs)
    return {
        agent: {
            name: mean_of_known([r.metrics[name] for r in runs if r.agent == agent])
            for name in COLUMNS
        }
        for agent in agents
    }


def metric_text(name: str, value: float) -> str:
    """Returns a metric of `COLUMNS` as text, a dash if it is not defined."""
    unit = _MS_PER_SECOND if name == "timing_error" else 1
    return fixed_number(unit * value, COLUMNS[name][1])


def comparison_page(runs: Sequence[Run], remarks: Sequence[str] = ()) -> Iterator[str]:
    """Yields the page of `runs`, of at least one, with `remarks` on how they differ."""
    longest, agents = max((run.episode for run in runs), key=_duration), means(runs)
    yield from render(
        "comparison.html",
        title=longest.song or "Untitled",
        facts={
            "length": f"{_duration(longest):.1f} s",
            "notes": str(len(key_runs(longest["goal_keys"])[0])),
            "agents": str(len(agents)),
            "seeds": ", ".join(str(seed) for seed in dict.fromkeys(run.seed for run in runs)),
        },
        bar_charts={COLUMNS[name][0]: _bars(name, runs) for name in _BARS},
        columns=[title for title, _ in COLUMNS.values()],
        rows={
            agent: [metric_text(name, metrics[name]) for name in COLUMNS]
            for agent, metrics in agents.items()
        },
        remarks=remarks,
        duration=_duration(longest),
        roll=_roll(longest),
        strips=[_strip(run) for run in runs],
        run_pages=map(_run_page, runs),
        shared={name: text for name, text in _shared().items() if name != _UPLOT},
        styles=_STYLES,
        scripts=_SCRIPTS,
    )


def _duration(episode: Episode) -> float:
    return episode.num_steps * episode.dt


def _run_page(run: Run) -> Iterator[str | list[str]]:
    """Yields the page of a run: its texts, and as a list the name of each shared asset."""
    names = {text: name for name, text in _shared().items()}
    settings = {"agent": run.agent, "seed": run.seed}
    audio = synthesize(played_in(run.episode))
    for piece in performance.performance_page(run.episode, run.metrics, settings, audio):
        yield [names[piece]] if piece in names else piece


def _shared() -> dict[str, str]:
    """Returns the assets of the pages of runs, as they stand in them."""
    plain = (*performance.STYLES, *performance.SCRIPTS, _UPLOT)
    return {name: asset(name) for name in plain} | {_THREE: packed_asset(_THREE)}


def _bars(name: str, runs: Sequence[Run]) -> list[Bar]:
    """Returns a bar for each agent, as long as the mean, with a dot for each of several seeds."""
    bars = []
    for agent, metrics in means(runs).items():
        each = [run.metrics[name] for run in runs if run.agent == agent]
        dots = each if len(each) > 1 else ()
        bars.append(Bar(agent, metrics[name], metric_text(name, metrics[name]), dots))
    return bars


def _roll(episode: Episode) -> dict[str, Any]:
    """Returns the piano roll of what the score asks for: names of the Cs, and SVG paths."""
    first, last, key = key_runs(episode["goal_keys"])
    lowest, num_keys = episode.lowest_pitch, episode["goal_keys"].shape[1]
    middle = min(max(_MIDDLE_C - lowest, 0), num_keys - 1)
    low = max(min([*key.tolist(), middle]) - _MARGIN, 0)
    high = min(max([*key.tolist(), middle]) + _MARGIN, num_keys - 1)
    rows = {k: _ROW * (high - k) for k in range(low, high + 1)}  # top [px] of each key
    notes = (
        f"M{i} {rows[k] + 1}H{j - _NOTE_GAP}v{_ROW - 2}H{i}z"
        for i, j, k in zip(first.tolist(), last.tolist(), key.tolist(), strict=True)
    )
    black = (
        f"M0 {top}h{episode.num_steps}v{_ROW}H0z" for k, top in rows.items() if is_black(k + lowest)
    )
    return {
        "names": {
            note_name(k + lowest): top + _ROW / 2
            for k, top in rows.items()
            if (k + lowest) % 12 == 0
        },
        "steps": episode.num_steps,
        "height": len(rows) * _ROW,
        "num_notes": len(first),
        "black_keys": "".join(black),
        "notes": "".join(notes),
    }


def _strip(run: Run) -> tuple[Run, str, dict[str, Any]]:
    """Returns a run, its key steps in words, and per step how many keys are hit, missed, wrong."""
    verdicts = verdict(run.episode["goal_keys"], run.episode["key_activation"])
    counts = {name: (verdicts == i + 1).sum(axis=1).tolist() for i, name in enumerate(VERDICTS)}
    sums = ", ".join(f"{sum(counts[name])} {name}" for name in ("hit", "missed", "wrong"))
    return run, f"Key steps of {run.name}: {sums}", {"dt": run.episode.dt, **counts}
