"""Writes the tables of figures in README.md and docs/ from the files of docs/results/.

    make tables

A table stands below a comment that says what is in it:

    <!-- table: pieces library=bundled by agent: f1 note_onset_f1 -->

has the means of the columns `f1` and `note_onset_f1` of `pieces.csv`, over its rows of the library
`bundled`, in a row for each agent, or without `by agent` in a single row.
`by setting across piece: f1` has a column for each piece.
"""

from __future__ import annotations

import argparse
import csv
import re
from pathlib import Path
from statistics import fmean

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
MARKED = re.compile(
    r"(<!-- table: (?P<file>\S+)(?P<where>(?: \w+=\S+)*)(?: by (?P<by>[\w ]+?))?"
    r"(?: across (?P<across>\w+))?: (?P<columns>[\w ]+) -->\n\n)(?:(?:\|.*\n)+\n)?"
)
Row = dict[str, str]

HEADINGS = {
    "bass": "bass played",
    "cpu_per_music": "CPU time / music",
    "extra_again": "own key again",
    "extra_brushed": "of these brushed",
    "extra_neighbour": "extra: neighbours",
    "extra_notes": "extra notes in 100",
    "extra_off_time": "late or early",
    "extra_other": "others",
    "f1": "F1",
    "f1_high": "to",
    "f1_low": "95 % from",
    "melody": "melody played",
    "missed_held": "still down",
    "missed_notes": "missed in 100",
    "missed_silent": "missed: silent",
    "note_onset_f1": "note onset F1",
    "note_onset_f1_high": "to",
    "note_onset_f1_low": "95 % from",
    "onset_error": "onset error [ms]",
    "onset_error_ms": "onset error [ms]",
    "original_f1": "F1 of the original",
    "pianist_finger": "pianist: finger",
    "pitch_classes": "pitch classes",
    "robot_finger": "robot: finger",
    "robot_hand": "robot: hand",
    "velocity_error": "velocity error",
}
DECIMALS = {
    **dict.fromkeys(("robots", "songs"), 0),
    **{"cpu_per_music": 2, "onset_error": 1, "onset_error_ms": 1, "velocity_error": 1},
    **{name: 1 for name in HEADINGS if name.startswith(("extra_", "missed_"))},
    **dict.fromkeys(("robot_hand", "robot_finger", "pianist_finger"), 2),
}
NAMES = {
    "repertoire:valid": "real music, 15 s each",
    "zero": "hands that stay where they are",
    "train:fast": "policies, one a piece",
    "predictive-sampling": "predictive sampling, one iteration a step",
    "planner-played-back": "planner, played back",
    "nominal": "plan with feedback",
    "nominal-played-back": "plan, played back",
    "stitched": "stitched motions",
    "arm-icp": "arms, nearest fingers",
    "arm-search": "arms, fingers of the search",
    "arm-unrehearsed": "arms, not rehearsed",
    "arm-together": "both arms at one piano",
    "True": "yes",
    "False": "no",
}


def mean(rows: list[Row], column: str) -> str:
    """Mean of a column over the rows that have a value there, or a dash."""
    values = [float(row[column]) for row in rows if row[column]]
    return f"{fmean(values):.{DECIMALS.get(column, 3)}f}" if values else "–"


def table(match: re.Match[str]) -> str:
    """A marker and its table in Markdown."""
    where = [condition.split("=") for condition in match["where"].split()]
    with (ROOT / "docs" / "results" / f"{match['file']}.csv").open(newline="") as file:
        rows = [
            row
            for row in csv.DictReader(file)
            if all(row[column] in values.split(",") for column, values in where)
        ]
    by, columns, across = (match["by"] or "").split(), match["columns"].split(), match["across"]
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[column] for column in by), []).append(row)
    splits = list(dict.fromkeys(row[across] for row in rows)) if across else []
    lines = [[*by, *(splits or (HEADINGS.get(column, column) for column in columns))]]
    lines.append(["---"] * len(lines[0]))
    for key, group in groups.items():
        names = [NAMES.get(value, value) for value in key]
        parts = [[row for row in group if row[across] == split] for split in splits] or [group]
        lines.append([*names, *(mean(part, column) for part in parts for column in columns)])
    return match[1] + "".join(f"| {' | '.join(line)} |\n" for line in lines) + "\n"


def written(page: str) -> str:
    """The text of a page with its tables as the results have them."""
    return MARKED.sub(table, page)


def main() -> None:
    argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0]).parse_args()
    for page in PAGES:
        page.write_text(written(page.read_text()))


if __name__ == "__main__":
    main()
