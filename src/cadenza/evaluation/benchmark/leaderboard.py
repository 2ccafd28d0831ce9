"""The table of entries, as CSV and in Markdown.

Its metrics are computed from the actions; claimed metrics are never shown.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any
from unicodedata import normalize

import numpy as np
from numpy.typing import NDArray

from cadenza.errors import CadenzaError, in_a_line, shortened
from cadenza.evaluation.benchmark.entry import ENTRY, read_entry
from cadenza.evaluation.benchmark.verification import PlayedAgain, verify
from cadenza.evaluation.statistics import bootstrap_interval, mean
from cadenza.evaluation.tables import write_csv
from cadenza.files import write_atomically
from cadenza.music.score import MS_PER_SECOND

VERIFIED, UNVERIFIED, REFUSED = "verified", "unverified", "refused"
_ORDER = (VERIFIED, UNVERIFIED, REFUSED)
_DECIMALS = {"onset_error_ms": 1, "velocity_error": 1, "cpu_per_music": 2}  # 3 for others
_COLUMNS = {
    "status": "status",
    "name": "entry",
    "by": "by",
    "fingering": "fingering",
    "seeds": "seeds",
    "note_onset_f1": "note onset F1",
    "note_onset_f1_low": "95 % from",
    "note_onset_f1_high": "to",
    "f1": "F1",
    "onset_error_ms": "onset error [ms]",
    "velocity_error": "velocity error",
    "cpu_per_music": "CPU time / music",
    "about": "about",
    "why": "why not verified",
}  # of Markdown, with their titles; the CSV file has more
_SHARES = ("f1", "precision", "recall", "pooled_f1")  # beside note onset F1
_CLAIMS = ("songs", "track", "name", "by", "fingering", "agent", "about")  # fields of the entry
Row = dict[str, Any]


def entries_in(folders: Iterable[Path]) -> list[Path]:
    """The folders that are entries, or the entries in them.

    Raises CadenzaError if one is no folder.
    """
    entries: list[Path] = []
    for folder in folders:
        if not folder.is_dir():
            raise CadenzaError(f"{folder}: there is no such folder; give that of an entry")
        paths = sorted(folder.glob(ENTRY)) or sorted(folder.glob(f"*/{ENTRY}"))
        entries += [path.parent for path in paths] or [folder]
    return list(dict.fromkeys(entries))


def row_of(folder: Path) -> Row:
    """Play an entry again, and return its row, with the reason if it is not verified."""
    row: Row = {"songs": "", "track": "", **dict.fromkeys(_COLUMNS, ""), "folder": folder.name}
    row |= {"name": folder.name, "note_onset_f1": math.nan, "f1": math.nan}
    try:
        entry = read_entry(folder)
        row |= {name: getattr(entry, name) for name in _CLAIMS}
        row |= {name: entry.versions.get(name, "") for name in ("mujoco", "cadenza")}
        row["seeds"] = len(entry.seeds)
        played = verify(folder)
        row |= means(played) | {"status": VERIFIED}
        if played.differences:
            row |= {"status": UNVERIFIED, "why": played.differences[0]}
    except Exception as error:  # of any kind: other entries have their rows
        row |= {"status": REFUSED, "why": in_a_line(error, folder)}
    return {name: shortened(v) if isinstance(v, str) else v for name, v in row.items()}


def write_leaderboard(folder: Path, rows: Sequence[Row]) -> list[Path]:
    """Write leaderboard.csv and leaderboard.md; return their paths.

    Rows are ordered by set and track, then by status, note onset F1 and F1.
    """
    rows = sorted(
        rows,
        key=lambda row: (
            *(row["songs"], row["track"], _ORDER.index(row["status"])),
            *(-np.nan_to_num([row["note_onset_f1"], row["f1"]])).tolist(),
            row["name"],
        ),
    )
    table, text = (folder / f"leaderboard.{suffix}" for suffix in ("csv", "md"))
    texts = ({n: _as_text(v) if isinstance(v, str) else v for n, v in row.items()} for row in rows)
    write_csv(table, list(texts))
    with write_atomically(text) as file:
        file.write(_markdown(rows).encode())
    return [table, text]


def means(played: PlayedAgain) -> Row:
    """Means over the songs of the means over the seeds."""
    entry = played.entry
    songs = list(dict.fromkeys(run.song for run in entry.runs))

    def scores(name: str) -> NDArray[np.float64]:
        """The values (seeds, songs) of a metric."""
        rows = [[played.metrics[song, seed][name] for song in songs] for seed in entry.seeds]
        return np.array(rows, np.float64)

    onsets = scores("note_onset_f1")
    low, high = bootstrap_interval(onsets)
    cpu = [math.nan if run.cpu_seconds is None else run.cpu_seconds for run in entry.runs]
    return {
        "note_onset_f1": float(mean(onsets)),
        "note_onset_f1_low": low,
        "note_onset_f1_high": high,
        **{n: float(mean(scores(n))) for n in _SHARES},
        "onset_error_ms": MS_PER_SECOND * _mean_of_known(scores("onset_error_median")),
        "velocity_error": _mean_of_known(scores("velocity_error")),
        "cpu_per_music": math.fsum(cpu) / played.seconds,
    }


def _mean_of_known(values: NDArray[np.float64]) -> float:
    """The mean of the values (...) that are not NaN; NaN if all are."""
    finite = values[~np.isnan(values)]
    return float(finite.mean()) if len(finite) else math.nan


def _as_text(value: str) -> str:
    """A text that spreadsheets neither take for a formula nor split at `;`."""
    value = value.replace(";", ",")
    begins_a_formula = normalize("NFKC", value).startswith(("=", "+", "-", "@"))  # of any width
    return f"'{value}" if begins_a_formula else value


def _markdown(rows: Sequence[Row]) -> str:
    """A table for each set and track; text of cells is escaped."""
    lines: list[str] = []
    for (songs, track), section in groupby(rows, lambda row: (row["songs"], row["track"])):
        title = f"{songs}, {track}" if songs else "not read"
        lines += [f"## {_plain(title)}", ""]
        lines += [_line(list(_COLUMNS.values())), f"|{' --- |' * len(_COLUMNS)}"]
        lines += [*(_line([_text(row, name) for name in _COLUMNS]) for row in section), ""]
    return "\n".join(lines)


def _text(row: Row, name: str) -> str:
    value = row[name]
    if isinstance(value, float):
        return "–" if math.isnan(value) else f"{value:z.{_DECIMALS.get(name, 3)}f}"
    return str(value)


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(map(_plain, cells))} |"


def _plain(text: str) -> str:
    return "".join(f"\\{c}" if c in "\\`*_[]<>|#~&" else c for c in text)
