"""The table of the benchmark's entries as an HTML page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from cadenza.report.charts import STYLES
from cadenza.report.html_pages import render, write_page


def write_leaderboard_page(
    path: Path, titles: Mapping[str, bool], sections: Mapping[str, Sequence[Sequence[str]]]
) -> None:
    """Writes a page with a table for each section.

    Args:
        path: where it goes.
        titles: the titles of the columns, and whether they hold text, of any length, or figures.
        sections: title -> the rows, each a text for every column; all of it is escaped.
    """
    page = render(
        "leaderboard.html",
        title="Leaderboard",
        facts={"entries": str(sum(map(len, sections.values())))},
        styles=(*STYLES, "results.css"),
        titles=titles,
        sections=sections,
    )
    write_page(path, page)
