"""The page and the table that compare agents."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from conftest import make_episode

from cadenza.report.comparison import COLUMNS, Run, in_text, means, write_comparison


def run(agent: str, seed: int, f1: float, **figures: float) -> Run:
    return Run(agent, seed, dict.fromkeys(COLUMNS, f1) | figures, make_episode())


RUNS = (
    run("planner", 0, 0.9, energy=0.7, timing_error=0.012),
    run("planner", 1, 0.8, energy=1.1, timing_error=0.024),
    run("<zero>", 0, 0.25, timing_error=math.nan),
)


class Elements(HTMLParser):
    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


@pytest.fixture
def page(tmp_path: Path) -> str:
    write_comparison(tmp_path / "compare.html", RUNS)
    return (tmp_path / "compare.html").read_text()


def test_means_leave_out_what_is_not_defined() -> None:
    found = means([*RUNS, run("<zero>", 1, 0.5, timing_error=0.1)])
    assert found["planner"]["f1"] == pytest.approx(0.85)
    assert found["planner"]["timing_error"] == pytest.approx(0.018)
    assert found["<zero>"]["timing_error"] == pytest.approx(0.1)
    assert math.isnan(means(RUNS)["<zero>"]["timing_error"])


def test_the_table_in_text_stands_in_columns() -> None:
    lines = in_text(RUNS).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert lines[1].split() == ["planner", *["0.850"] * 4, "18", "0.9", "0.85"]
    assert lines[2].split()[5] == "–"


def test_the_page_tells_the_means(page: str) -> None:
    words = re.sub(r"<style>.*</style>|<[^>]+>", " ", page, flags=re.DOTALL).split()
    assert words.count("0.850") == 8  # a bar and a cell for each of four
    assert "&lt;zero&gt;" in words


def test_bars_are_as_long_as_the_means(page: str) -> None:
    styles = [a.get("style") for tag, a in Elements(page).found if tag == "i" and "style" in a]
    assert styles == ["width:85.0%", "width:25.0%"] * 4
    dots = [a["style"] for tag, a in Elements(page).found if tag == "u"]
    assert dots == ["left:90.0%", "left:80.0%"] * 4


def area(path: str) -> float:
    """What the blocks of an SVG path cover."""
    blocks = re.findall(r"M(\d+) (-?\d+)H(\d+)V(-?\d+)H(\d+)z", path)
    return sum((int(b) - int(a)) * abs(int(v) - int(u)) for a, u, b, v, _ in blocks)


def test_strips_show_how_many_keys_were_right_missing_and_wrong(page: str) -> None:
    episode = make_episode()
    goal, played = episode["goal_keys"], episode["key_activation"]
    expected = {"hit": goal & played, "missed": goal & ~played, "wrong": played & ~goal}
    paths = [a for tag, a in Elements(page).found if tag == "path"]
    for name, keys in expected.items():
        areas = [area(str(a["d"])) for a in paths if a.get("class") == name]
        assert len(areas) == len(RUNS)
        assert set(np.array(areas) / 6) == {keys.sum()}


def test_the_page_stands_alone(page: str) -> None:
    assert not re.search(r"https?://|<script|<link rel=\"stylesheet|@import|url\(", page)
    assert "{{" not in page


def test_an_episode_that_ended_early(tmp_path: Path) -> None:
    short = replace(RUNS[2], episode=make_episode(steps=10))
    write_comparison(tmp_path / "compare.html", [short, RUNS[0]])
    views = re.findall(r'viewBox="0 \S+ (\d+) ', (tmp_path / "compare.html").read_text())
    assert set(views) == {"40"}
