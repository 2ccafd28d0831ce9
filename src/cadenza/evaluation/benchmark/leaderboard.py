"""The table of entries: as a page, as CSV and in Markdown.

Its figures are those that were computed here, from the actions; those on cards are never shown.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any
from unicodedata import normalize

import numpy as np

from cadenza.errors import CadenzaError, in_a_line
from cadenza.evaluation.benchmark.card import CARD, Card, read_card
from cadenza.evaluation.benchmark.verification import Verified, verify
from cadenza.evaluation.statistics import bootstrap_interval, mean
from cadenza.evaluation.tables import write_csv
from cadenza.files import files_in, write_atomically
from cadenza.music.formats.titles import printable
from cadenza.report.charts import mean_of_known
from cadenza.report.leaderboard_page import write_leaderboard_page

_MS_PER_SECOND = 1000
_SEED = 0  # of the bootstrap: the same entries have the same intervals
_DECIMALS = {"f1": 3, "note_onset_f1": 3, "onset_error_ms": 1, "velocity_error": 1}
_DECIMALS |= {"cpu_per_music": 2, "gpu_hours": 1, "cpu_hours": 1}
COLUMNS = {
    "name": "entry",
    "by": "by",
    "fingering": "fingering",
    "seeds": "seeds",
    "f1": "F1",
    "f1_interval": "95 % interval",
    "note_onset_f1": "note onset F1",
    "onset_error_ms": "onset error [ms]",
    "velocity_error": "velocity error",
    "cpu_per_music": "CPU time / music",
    "training_steps": "training steps",
    "cpu_hours": "CPU hours",
    "gpu_hours": "GPU hours",
    "verified": "verified",
    "data": "learnt from",
}
"""Columns of the page and of Markdown, with their titles; the CSV file has more."""
_SAID = ("songs", "track", "name", "by", "fingering", "agent", "data", "hardware")  # on a card
_WORDS = ("name", "by", "verified", "data")  # columns of text, not of figures
_SCORES = ("note_onset_f1", "precision", "recall", "pooled_f1")  # beside F1
Row = dict[str, Any]
_Scores = frozenset[tuple[str | float | None, ...]]


@dataclass(frozen=True)
class Standing:
    """An entry as the table has it."""

    folder: Path
    card: Card | None
    """Its card; None if that cannot be read."""
    verified: Verified | None
    """What was computed; None if it could not be played again."""
    why: str = ""
    """Why not, in a line."""


def standing(entry: Path) -> Standing:
    """Plays an entry again."""
    card = None
    try:
        card = read_card(entry)
        return Standing(entry, card, verify(entry))
    except Exception as error:  # whatever an entry causes, the others are played
        return Standing(entry, card, None, printable(in_a_line(error, entry)))


def entries_in(folders: Iterable[Path]) -> list[Path]:
    """The folders of entries: those with a card, or else all in them with one.

    Raises:
        CadenzaError: there is no entry in one of them.
    """
    found: list[Path] = []
    for folder in folders:
        cards = [path for path in sorted(files_in(folder)) if path.name == CARD]
        if Path(CARD) in cards:
            cards = [Path(CARD)]
        if not cards:
            raise CadenzaError(
                f"{folder}: holds no entry, which has a {CARD}; make one with cadenza enter"
            )
        found += [(folder / card).parent for card in cards]
    return list(dict.fromkeys(found))


def write_leaderboard(folder: Path, standings: Sequence[Standing]) -> list[Path]:
    """Writes index.html, leaderboard.csv and leaderboard.md; returns their paths."""
    rows = leaderboard(standings)
    page = folder / "index.html"
    table, text = (folder / f"leaderboard.{suffix}" for suffix in ("csv", "md"))
    write_csv(table, [_without_formulas(row) for row in rows])
    shown = {
        title: [[_text(row, name) for name in COLUMNS] for row in section]
        for title, section in groupby(rows, _section)
    }
    with write_atomically(text) as file:
        file.write(_markdown(shown).encode())
    write_leaderboard_page(page, {title: name in _WORDS for name, title in COLUMNS.items()}, shown)
    return [page, table, text]


def leaderboard(standings: Sequence[Standing]) -> list[Row]:
    """The rows: by set and track, the best F1 first, and entries without figures last."""
    verified = (s.verified for s in standings if s.verified is not None)
    played = Counter(_scores_of_songs(v) for v in verified if not v.problems)
    rows = [_row(standing, played) for standing in standings]
    return sorted(
        rows, key=lambda row: (row["songs"], row["track"], -np.nan_to_num(row["f1"]), row["name"])
    )


def _row(standing: Standing, played: Mapping[_Scores, int]) -> Row:
    card, verified = standing.card, standing.verified
    row: Row = dict.fromkeys(("songs", "track", *COLUMNS), "")
    del row["f1_interval"]  # made of `f1_low` and `f1_high` where it is shown
    folder = printable(standing.folder.name)
    row |= {"folder": folder, "name": folder, "f1": math.nan}
    if card is not None:
        row |= {name: getattr(card, name) for name in _SAID}
        row |= {
            "training_steps": card.effort.steps,
            "cpu_hours": card.effort.cpu_hours,
            "gpu_hours": card.effort.gpu_hours,
            "seeds": len(card.seeds),
            **{name: card.versions.get(name, "") for name in ("mujoco", "cadenza")},
        }
    if card is None or verified is None or verified.problems:
        why = verified.words if verified is not None else standing.why
        return row | {"verified": f"no: {why}"}
    row |= figures(verified)
    copy = played[_scores_of_songs(verified)] > 1
    return row | {"verified": verified.words + "; plays every song as another entry does" * copy}


def _scores_of_songs(verified: Verified) -> _Scores:
    """Returns what tells copies: scores count keys and notes, so a bit more or less is the same."""
    return frozenset(
        (song, *(metrics[name] for name in ("f1", *_SCORES)))
        for (song, _), metrics in verified.metrics.items()
    )


def figures(verified: Verified) -> Row:
    """Means over the songs of the means over the seeds."""
    card = verified.card
    songs = list(dict.fromkeys(run.song for run in card.runs))

    def scores(name: str) -> Any:
        """The values (seeds, songs) of a metric."""
        rows = [[verified.metrics[song, seed][name] for song in songs] for seed in card.seeds]
        return np.array(rows, np.float64)

    f1 = scores("f1")
    low, high = bootstrap_interval(mean, f1, np.random.default_rng(_SEED))
    cpu = [math.nan if run.cpu_seconds is None else run.cpu_seconds for run in card.runs]
    return {
        "f1": float(mean(f1)),
        "f1_low": float(low),
        "f1_high": float(high),
        **{name: float(mean(scores(name))) for name in _SCORES},
        "onset_error_ms": _MS_PER_SECOND * mean_of_known(scores("onset_error_median").ravel()),
        "velocity_error": mean_of_known(scores("velocity_error").ravel()),
        "cpu_per_music": math.fsum(cpu) / verified.seconds,
    }


def _section(row: Row) -> str:
    return f"{row['songs']}, {row['track']}" if row["songs"] else "Not read"


def _without_formulas(row: Row) -> Row:
    """Returns a row of which no spreadsheet takes a text for a formula."""
    begin = ("=", "+", "-", "@")  # also in their full-width forms
    texts = ((name, value) for name, value in row.items() if isinstance(value, str))
    return row | {
        name: f"'{text}" for name, text in texts if normalize("NFKC", text).startswith(begin)
    }


def _text(row: Row, name: str) -> str:
    if name == "f1_interval":
        low, high = row.get("f1_low", math.nan), row.get("f1_high", math.nan)
        return "" if math.isnan(low) else f"{low:.3f}–{high:.3f}"
    value = row[name]
    if value is None:
        return "–"
    if isinstance(value, float):
        return "–" if math.isnan(value) else f"{value:z.{_DECIMALS[name]}f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def _markdown(sections: Mapping[str, Sequence[Sequence[str]]]) -> str:
    """Returns a table for each section; what entries say can neither end a cell nor mark up."""
    lines: list[str] = []
    for title, rows in sections.items():
        lines += [f"## {_plain(title)}", ""]
        lines += [_line(list(COLUMNS.values())), f"|{' --- |' * len(COLUMNS)}"]
        lines += [*(_line(row) for row in rows), ""]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(_plain, cells))} |"


def _plain(text: str) -> str:
    return "".join(f"\\{c}" if c in "\\`*_[]<>|#~&" else c for c in " ".join(text.split()))
