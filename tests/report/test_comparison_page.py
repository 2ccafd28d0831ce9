"""The page and the table that compare agents."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from made_up_episode import make_episode

from cadenza.cli.compare import in_text
from cadenza.report.comparison_page import COLUMNS, Run, comparison_page, means
from cadenza.report.html_pages import asset, packed_asset, write_page
from headless import Browser, needs_chromium


def run(agent: str, seed: int, f1: float, **metrics: float) -> Run:
    return Run(agent, seed, dict.fromkeys(COLUMNS, f1) | metrics, make_episode())


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
    write_page(tmp_path / "compare.html", comparison_page(RUNS))
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
    unseen = r"<(style|script)[^>]*>.*?</\1>|<[^>]+>"
    words = re.sub(unseen, " ", page, flags=re.DOTALL).split()
    assert words.count("0.850") == 8  # a bar and a cell for each of four
    assert "&lt;zero&gt;" in words


def test_bars_are_as_long_as_the_means(page: str) -> None:
    styles = [a.get("style") for tag, a in Elements(page).found if tag == "i" and "style" in a]
    assert styles == ["width:85.0%", "width:25.0%"] * 4
    dots = [a["style"] for tag, a in Elements(page).found if tag == "u"]
    assert dots == ["left:90.0%", "left:80.0%"] * 4


def strips(page: str) -> list[dict]:
    found = re.findall(r'class="strip".*?json">(.*?)</script>', page, re.DOTALL)
    return [json.loads(strip) for strip in found]


def test_strips_show_how_many_keys_were_right_missing_and_wrong(page: str) -> None:
    episode = make_episode()
    goal, played = episode["goal_keys"], episode["key_activation"]
    expected = {"hit": goal & played, "missed": goal & ~played, "wrong": played & ~goal}
    found = strips(page)
    assert len(found) == len(RUNS)
    for strip in found:
        assert strip["dt"] == episode.dt
        for name, keys in expected.items():
            assert strip[name] == keys.sum(axis=1).tolist()
    assert 'data-words="Key steps of &lt;zero&gt;, seed 0: 16 hit, 24 missed, 5 wrong"' in page


def test_the_page_stands_alone(page: str) -> None:
    for tag, attributes in Elements(page).found:
        assert tag not in ("object", "embed", "base"), tag
        for name in ("src", "href", "srcset", "data", "poster", "action"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, attributes)
    assert "default-src 'none'" in page
    assert "{{" not in page


def test_what_the_page_and_its_runs_share_is_there_once(page: str) -> None:
    word = max(re.findall(r"\w+", asset("uplot.min.js")), key=len)
    assert page.count(word) == asset("uplot.min.js").count(word)
    assert page.count(packed_asset("three.min.js")) == 1


def opened(browser: Browser, path: Path) -> None:
    browser.events.clear()
    browser.call("Page.navigate", url=path.as_uri())
    browser.wait("!!window.comparison && comparison.ready")


@needs_chromium
@pytest.mark.slow
def test_each_run_is_seen_and_heard(browser: Browser, tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>{{js}}"
    late = make_episode()
    late.arrays["key_activation"][:, :] = False
    runs = [*RUNS, replace(RUNS[0], agent=evil, episode=late)]
    write_page(tmp_path / "compare.html", comparison_page(runs))
    opened(browser, tmp_path / "compare.html")
    inside = "document.getElementById('frame').contentWindow"
    facts = f"{inside}.document.querySelector('.facts').textContent"
    recall = f"{inside}.document.querySelector('#roll canvas').getAttribute('aria-label')"
    assert "agent planner" in browser.evaluate(facts)
    assert "20 were hit" not in browser.evaluate(recall)

    browser.evaluate(f"{inside}.cadenza.seek(0.3)")
    browser.evaluate(f"{inside}.cadenza.play()")
    browser.wait(f"{inside}.cadenza.time > 0.5")
    browser.evaluate("document.querySelector('button[data-run=\"3\"]').click()")
    browser.wait("comparison.ready")
    assert evil in browser.evaluate(facts)
    assert " 0 were hit" in browser.evaluate(recall)
    browser.wait(f"{inside}.cadenza.playing && {inside}.cadenza.time > 0.5")

    browser.evaluate(
        "(strip => strip.dispatchEvent(new MouseEvent('click', { bubbles: true, clientX:"
        " strip.getBoundingClientRect().left + 0.75 * strip.clientWidth })))"
        "(document.querySelector('.strip[data-run=\"1\"]'))"
    )
    browser.wait("comparison.ready")
    assert browser.evaluate("document.getElementById('choice').value") == "1"
    assert 1.5 <= browser.evaluate(f"{inside}.cadenza.time") < 1.9
    assert browser.problems() == []


@needs_chromium
@pytest.mark.slow
def test_labels_do_not_overlap_on_any_screen(browser: Browser, tmp_path: Path) -> None:
    long = run("a/folder/with_a_rather_long_name_of_a_run/best", 12, 0.5)
    write_page(tmp_path / "compare.html", comparison_page([*RUNS, long]))
    for width in (320, 390, 900, 1280):
        screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.call("Emulation.setDeviceMetricsOverride", **screen)
        opened(browser, tmp_path / "compare.html")
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        overlaps = browser.evaluate("""(() => {
            const labels = ".bars dt, .bars dd b, .whose, .strip, h2, .legend span";
            const boxes = [...document.querySelectorAll(labels)]
              .filter((label) => getComputedStyle(label).visibility !== "hidden")
              .map((label) => [label.textContent, label.getBoundingClientRect()]);
            const apart = (a, b) => a.right < b.left + 1 || a.bottom < b.top + 1;
            return boxes.flatMap(([text, a], i) => boxes.slice(i + 1)
              .filter(([, b]) => !apart(a, b) && !apart(b, a))
              .map(([other]) => `${text} | ${other}`));
        })()""")
        assert overlaps == []
        assert browser.colliding_labels() == []
        assert browser.problems() == []


@needs_chromium
@pytest.mark.slow
def test_strips_share_a_time_axis_and_tell_their_counts(browser: Browser, tmp_path: Path) -> None:
    """Also that of an episode which ended after a quarter of the time."""
    short = replace(RUNS[2], episode=make_episode(steps=10))
    write_page(tmp_path / "compare.html", comparison_page([short, RUNS[0]]))
    screen = {"width": 1000, "height": 1200, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **screen)
    opened(browser, tmp_path / "compare.html")
    hit = (0x00, 0x9E, 0x73)
    for strip, (first, end) in enumerate(((4, 10), (4, 20))):
        picture = browser.picture(f'div.strip[data-run="{strip}"]').astype(int)
        lit = np.flatnonzero((np.abs(picture - hit).max(axis=2) < 24).any(axis=0))
        expected = np.array([first, end]) / 40 * picture.shape[1]
        np.testing.assert_allclose([lit[0], lit[-1] + 1], expected, atol=2)

    left, top, width = browser.evaluate(
        "(({ left, top, width }) => [left, top, width])"
        "(document.querySelector('div.strip[data-run=\"1\"]').getBoundingClientRect())"
    )
    browser.call("Input.dispatchMouseEvent", type="mouseMoved", x=left + 0.66 * width, y=top + 3)
    values = "document.querySelector('.u-legend:not([hidden])').innerText.replace(/\\s+/g, ' ')"
    assert browser.evaluate(values).strip() == "time 1.30 s hit 0 missed 1 wrong 1"
    assert browser.problems() == []
