"""`cadenza results`: the page and the tables of the results of a bench."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from cadenza.cli.arguments import Output, Quiet
from cadenza.cli.printing import in_columns
from cadenza.cli.saving import check_name, check_writable

if TYPE_CHECKING:
    from cadenza.evaluation.summary import BenchSummary


@dataclass(frozen=True)
class Results:
    """Sum up the runs of "cadenza bench": a page, tables and a figure.

    Example: cadenza results bench
    """

    bench: tyro.conf.Positional[Path]
    """Folder of a bench."""
    output: Output[Path | None] = None
    """Folder for index.html and the tables; BENCH/results by default."""
    figure: Path | None = None
    """Draw the bar chart of all pieces, an .svg file, too."""
    quiet: Quiet = False


def results(command: Results) -> None:
    from cadenza.evaluation.results import read_results
    from cadenza.evaluation.summary import summarize
    from cadenza.evaluation.summary_page import summary_page, write_figure
    from cadenza.evaluation.tables import write_tables
    from cadenza.report.html_pages import write_page

    folder = command.output or command.bench / "results"
    if command.figure:
        check_name(command.figure, ".svg", "the figure is an .svg picture")
    summary = summarize(read_results(command.bench), command.bench.resolve().name)
    check_writable(folder)
    tables = write_tables(folder, summary)
    index = folder / "index.html"
    write_page(index, summary_page(summary, folder, tables))
    if command.figure:
        write_figure(command.figure, summary)
    print(in_text(summary))
    for caveat, _ in summary.caveats:
        print(caveat)
    print(f"\nOpen {index}")


def in_text(summary: BenchSummary) -> str:
    """The table of agents for a terminal: means."""
    from cadenza.evaluation.summary import HEADLINES, METRICS, interval_text, metric_text

    titles = [METRICS[name].title for name in HEADLINES]
    rows = [["", "pieces", "runs", titles[0], "95 % interval", *titles[1:]]]
    for group in summary.groups:
        if len(summary.groups) > 1:
            rows.append([group.name, *[""] * (len(rows[0]) - 1)])
        for agent, own in group.agents.items():
            first, *rest = (metric_text(name, own.mean[name].value) for name in HEADLINES)
            interval = interval_text(HEADLINES[0], own.mean[HEADLINES[0]])
            rows.append([agent, str(own.pieces), str(own.runs), first, interval, *rest])
    return in_columns(rows)
