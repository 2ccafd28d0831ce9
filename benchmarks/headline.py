"""Draws the paper's headline figure, a bar for each whole piece, of benches of a library.

    python -m benchmarks.headline BENCH [BENCH ...] --index index.csv -o docs/results

writes `headline-NAME.svg` for each bench, such as `headline-valid.svg` for `bench-valid`, and
`headline.csv` with every piece of all of them. Pieces that are not finished are left out, and
counted. The table of the library says who wrote each piece and where it is from: its column `id`
has the names of the files.
"""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cadenza.errors import CadenzaError, errors_in_a_line
from cadenza.evaluation.caveats import usable
from cadenza.evaluation.results import BenchResults, Result, read_results
from cadenza.evaluation.summary import run_metrics, summarize
from cadenza.evaluation.summary_page import write_csv, write_figure
from cadenza.files import content_of

_ABOUT = ("title", "composer", "opus", "licence", "source")
_FIGURES = {  # name -> decimals
    **dict.fromkeys(("f1", "note_onset_f1", "precision", "recall"), 4),
    **dict.fromkeys(("onset_error", "velocity_error", "cpu_per_music"), 2),
}
Pieces = Mapping[str, Mapping[str, str]]
"""Name of a piece's file without its ending -> what the table says of it."""


def titled(found: BenchResults, pieces: Pieces) -> BenchResults:
    """The results with the titles and composers of their pieces.

    Raises:
        CadenzaError: the table has no such piece.
    """
    results = []
    for result in found.results:
        about = about_piece(result, pieces)
        song = replace(result.song, title=about["title"], composer=about["composer"])
        results.append(replace(result, song=song))
    return replace(found, results=tuple(results))


def about_piece(result: Result, pieces: Pieces) -> Mapping[str, str]:
    """What the table says of the piece of a run.

    Raises:
        CadenzaError: it has no such piece.
    """
    if (name := Path(result.song.name).stem) not in pieces:
        raise CadenzaError(f"{name}: is not in the table; give that of its library with --index")
    return pieces[name]


def rows(split: str, results: Sequence[Result], pieces: Pieces) -> Iterator[dict[str, Any]]:
    """Yields a row for each run of a bench."""
    for result in sorted(results, key=lambda result: (result.agent, result.song.name)):
        about, measured = about_piece(result, pieces), run_metrics(result.metrics, result.timing)
        row: dict[str, Any] = {name: about[name] for name in _ABOUT}
        row |= {"split": split, "seconds": round(result.timing.music_seconds, 2)}
        row |= {"notes": result.song.notes, "agent": result.agent, "seed": result.seed}
        yield row | {
            name: math.nan if math.isnan(measured[name]) else round(measured[name], decimals)
            for name, decimals in _FIGURES.items()
        }


@errors_in_a_line()
def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("benches", nargs="+", type=Path, metavar="BENCH")
    parser.add_argument("--index", type=Path, required=True, help="table of the library")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the figures")
    options = parser.parse_args()
    table = csv.DictReader(content_of(options.index).decode().splitlines())
    pieces = {line["id"]: line for line in table}
    everything: list[dict[str, Any]] = []
    for bench in options.benches:
        name = bench.name.removeprefix("bench-")
        found = titled(read_results(bench), pieces)
        summary = summarize(found, name)
        write_figure(options.output / f"headline-{name}.svg", summary)
        everything += rows(name, usable(found), pieces)
        for agent in summary.agents:
            own = summary.groups[0].agents[agent]
            means = ", ".join(f"{figure} {own.mean[figure].value:.3f}" for figure in _FIGURES)
            print(f"{name}, {agent}: {own.pieces} pieces, {means}")
        print(f"{name}: {len(found.unfinished)} runs are not finished")
    write_csv(options.output / "headline.csv", everything)


if __name__ == "__main__":
    main()
