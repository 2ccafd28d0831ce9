"""Several agents at the same song as one HTML file: figures, what went right when, and every run.

No network, no server. The file grows by about a megabyte for each minute of each run, nearly all
of it sound.
"""

from __future__ import annotations

import html
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from cadenza.episode import Episode
from cadenza.music.performance import key_runs, played_in
from cadenza.music.score import is_black, note_name
from cadenza.report.asset import asset
from cadenza.report.bars import Bar, bars
from cadenza.report.page import own_parts, pieces, shared_parts, write_page
from cadenza.report.recording import VERDICTS, embedded, in_json, verdict
from cadenza.report.sound import SAMPLE_RATE, synthesize

COLUMNS = {
    "f1": ("F1", 3),
    "precision": ("Precision", 3),
    "recall": ("Recall", 3),
    "note_onset_f1": ("Note onset F1", 3),
    "timing_error": ("Timing error [ms]", 0),
    "energy": ("Energy [J]", 1),
    "planning": ("Planning time / music", 2),
}
"""Figures of a run -> what they are called, and how many decimals are shown."""
_STYLES = ("uplot.min.css", "page.css", "chart.css", "comparison.css")
_BARS = ("f1", "precision", "recall", "note_onset_f1")
_MIDDLE_C = 60
_ROW = 7  # [px] height of a key in the piano roll


@dataclass(frozen=True)
class Run:
    """One episode of one agent."""

    agent: str
    seed: int
    figures: Mapping[str, float]
    """Those of `COLUMNS`; NaN where one is not defined."""
    episode: Episode


def means(runs: Sequence[Run]) -> dict[str, dict[str, float]]:
    """Agent -> mean of each figure over its runs, of those in which it is defined."""
    agents = dict.fromkeys(run.agent for run in runs)
    return {
        agent: {
            name: _mean([r.figures[name] for r in runs if r.agent == agent]) for name in COLUMNS
        }
        for agent in agents
    }


def _mean(values: Sequence[float]) -> float:
    defined = [value for value in values if not math.isnan(value)]
    return math.fsum(defined) / len(defined) if defined else math.nan


def write_comparison(path: Path, runs: Sequence[Run], remarks: Sequence[str] = ()) -> None:
    """Writes the page of `runs`, of at least one, to `path`, with `remarks` on how they differ."""
    longest = max((run.episode for run in runs), key=_duration)
    title = html.escape(longest.song or "Untitled")
    shared = shared_parts()
    uplot = shared.pop("uplot")  # this page runs it, too, and has it where that can be done
    parts = {
        "title": title,
        "facts": _facts(runs, longest),
        "table": _table(means(runs)),
        "bars": "".join(_bars(name, runs) for name in _BARS),
        "roll": _roll(longest),
        "remarks": "".join(f"<p>{html.escape(remark)}</p>" for remark in remarks),
        "strips": "".join(_strip(i, run) for i, run in enumerate(runs)),
        "choices": "".join(
            f'<option value="{i}">{html.escape(_name(run))}</option>' for i, run in enumerate(runs)
        ),
        "duration": f"{_duration(longest):g}",
        "runs": chain.from_iterable(map(_embedded, runs)),
        "shared": in_json(shared),
        "uplot": uplot,
        "js": asset("chart.js") + asset("comparison.js"),
        "css": "".join(map(asset, _STYLES)),
    }
    write_page(path, "comparison.html", parts)


def _duration(episode: Episode) -> float:
    return episode.num_steps * episode.dt


def _name(run: Run) -> str:
    return f"{run.agent}, seed {run.seed}"


def _embedded(run: Run) -> Iterator[str]:
    """The page of a run as JSON: its texts, and a list of a name for a part that all runs share."""
    episode = run.episode
    audio = synthesize(played_in(episode))
    shared = dict.fromkeys(shared_parts(), "")
    settings = {"agent": run.agent, "seed": run.seed}
    own = own_parts(episode, run.figures, settings, embedded(episode, audio, SAMPLE_RATE))
    yield '<script type="application/json" class="run">[""'
    for name, text in pieces("page.html", own | shared):
        yield f",{in_json([name] if name in shared else text)}"
    yield "]</script>"


def _facts(runs: Sequence[Run], longest: Episode) -> str:
    seeds = ", ".join(str(seed) for seed in dict.fromkeys(run.seed for run in runs))
    notes = len(key_runs(longest["goal_keys"])[0])
    facts = {
        "length": f"{_duration(longest):.1f} s",
        "notes": str(notes),
        "agents": str(len(means(runs))),
        "seeds": seeds,
    }
    return "".join(f"<span>{name} <b>{value}</b></span>" for name, value in facts.items())


def shown(name: str, value: float) -> str:
    """A figure of `COLUMNS`; a dash if it is not defined."""
    if math.isnan(value):
        return "–"
    return f"{value * (1000 if name == 'timing_error' else 1):z.{COLUMNS[name][1]}f}"


def _table(figures: Mapping[str, Mapping[str, float]]) -> str:
    head = "".join(f'<th scope="col">{title}</th>' for title, _ in COLUMNS.values())
    rows = (
        f'<tr><th scope="row">{html.escape(agent)}</th>'
        + "".join(f"<td>{shown(name, of_agent[name])}</td>" for name in COLUMNS)
        + "</tr>"
        for agent, of_agent in figures.items()
    )
    return f"<table><thead><tr><td></td>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def _bars(name: str, runs: Sequence[Run]) -> str:
    """A bar an agent, as long as the mean, with a dot for each of several seeds."""
    lines = []
    for agent, figures in means(runs).items():
        each = [run.figures[name] for run in runs if run.agent == agent]
        dots = each if len(each) > 1 else ()
        lines.append(Bar(agent, figures[name], shown(name, figures[name]), dots))
    return bars(COLUMNS[name][0], lines)


def _roll(episode: Episode) -> str:
    """What the score asks for: names of the Cs, and the notes over rows of keys."""
    first, last, key = key_runs(episode["goal_keys"])
    lowest, num_keys = episode.lowest_pitch, episode["goal_keys"].shape[1]
    middle = min(max(_MIDDLE_C - lowest, 0), num_keys - 1)
    low = max(min([*key.tolist(), middle]) - 2, 0)
    high = min(max([*key.tolist(), middle]) + 2, num_keys - 1)
    height = (high - low + 1) * _ROW
    black = (
        f"M0 {_ROW * (high - k)}h{episode.num_steps}v{_ROW}H0z"
        for k in range(low, high + 1)
        if is_black(k + lowest)
    )
    notes = (
        f"M{i} {_ROW * (high - k) + 1}H{j - 0.15}v{_ROW - 2}H{i}z"
        for i, j, k in zip(first.tolist(), last.tolist(), key.tolist(), strict=True)
    )
    drawn = f'<path class="black" d="{"".join(black)}"/><path class="goal" d="{"".join(notes)}"/>'
    names = "".join(
        f'<span style="top:{_ROW * (high - k) + _ROW / 2:g}px">{note_name(k + lowest)}</span>'
        for k in range(low, high + 1)
        if (k + lowest) % 12 == 0
    )
    return (
        f'<div class="names">{names}</div><div>'
        f'<svg viewBox="0 0 {episode.num_steps} {height}" height="{height}" role="img" '
        f'preserveAspectRatio="none" aria-label="Piano roll of the {len(first)} notes to play">'
        f"{drawn}</svg></div>"
    )


def _strip(index: int, run: Run) -> str:
    """How many keys rightly sound, are missing and sound wrongly in each step."""
    verdicts = verdict(run.episode["goal_keys"], run.episode["key_activation"])
    counts = {name: (verdicts == i + 1).sum(axis=1).tolist() for i, name in enumerate(VERDICTS)}
    shares = ", ".join(f"{sum(counts[name])} {name}" for name in ("hit", "missed", "wrong"))
    words = html.escape(f"Key steps of {_name(run)}: {shares}")
    return (
        f'<button type="button" class="whose" data-run="{index}"><b>{html.escape(run.agent)}</b> '
        f"<small>seed {run.seed}</small></button>"
        f'<div class="strip" data-run="{index}" data-words="{words}">'
        f'<script type="application/json">{in_json({"dt": run.episode.dt, **counts})}</script>'
        "</div>"
    )
