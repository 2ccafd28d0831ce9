"""`cadenza results`: pages and tables of what the runs of a bench say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from cadenza.cli.arguments import Quiet
from cadenza.cli.output import check_name, check_writable, in_columns

if TYPE_CHECKING:
    from cadenza.report.overview import Overview


@dataclass(frozen=True)
class Results:
    """Sum up the runs of "cadenza bench": pages, tables and a figure.

    Example: cadenza results bench
    """

    bench: tyro.conf.Positional[Path]
    """Folder of a bench."""
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for index.html and the tables; BENCH/results by default."""
    figure: Path | None = None
    """Draw the bar chart of all pieces, an .svg file, too."""
    quiet: Quiet = False


def results(command: Results) -> None:
    from cadenza.evaluation.overview import overview
    from cadenza.evaluation.remarks import usable
    from cadenza.evaluation.results import read_results
    from cadenza.evaluation.tables import write_tables
    from cadenza.report.results_figure import write_figure
    from cadenza.report.results_page import write_results_pages

    folder = command.output or command.bench / "results"
    if command.figure:
        check_name(command.figure, ".svg", "the figure is an .svg picture")
    found = read_results(command.bench)
    told = overview(found, command.bench.resolve().name)
    check_writable(folder)
    tables = write_tables(folder, told, usable(found))
    index, *_ = write_results_pages(folder, told, tables)
    if command.figure:
        write_figure(command.figure, told)
    print(_in_text(told))
    for line, _ in told.remarks:
        print(line)
    print(f"\nOpen {index}")


def _in_text(told: Overview) -> str:
    """The table of agents, for a terminal: interquartile means."""
    from cadenza.report.overview import FIGURES, HEADLINES, SAME, in_interval, same_in_words, shown

    titles = [FIGURES[name].title for name in HEADLINES]
    rows = [["", "pieces", "runs", SAME.lower(), titles[0], "95 % interval", *titles[1:]]]
    for group in told.groups:
        rows.append([group.name, *[""] * (len(rows[0]) - 1)])
        for agent, of in group.standings.items():
            f1, *others = (shown(name, of.iqm[name].value) for name in HEADLINES)
            interval = in_interval(HEADLINES[0], of.iqm[HEADLINES[0]])
            counts = [str(of.pieces), str(of.runs), same_in_words(of)]
            rows.append([f"  {agent}", *counts, f1, interval, *others])
    return f"Interquartile means\n{in_columns(rows)}"
