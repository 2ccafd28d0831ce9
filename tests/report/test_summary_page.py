"""The page that sums up many runs."""

import re
import time
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from cadenza.evaluation.results import read_results
from cadenza.evaluation.summary import summarize
from cadenza.evaluation.summary_page import summary_page, write_figure
from cadenza.report.html_pages import write_page
from evaluation.made_up import AGENTS, result, write_bench, write_result
from headless import Browser, needs_chromium

BAD = "<i>\"&'/../x"
SIZES = ((1440, 900), (1280, 720), (390, 844))


def written(bench: Path, folder: Path | None = None) -> Path:
    """The text of index.html."""
    folder = folder or bench / "results"
    summary = summarize(read_results(bench), bench.name)
    write_page(folder / "index.html", summary_page(summary, folder, ["runs.csv"]))
    return folder / "index.html"


@pytest.fixture(scope="module")
def index(tmp_path_factory):
    bench = tmp_path_factory.mktemp("bench")
    write_bench(bench, pieces=24, agents=("planner", "ilqg"), seeds=3, libraries=2)
    (run,) = (bench / "runs").glob("000--ilqg--s0--*")
    (run / "result.json").write_text("{")
    return written(bench)


def words(page: str) -> str:
    shown = re.sub(r"<(style|title|script)\b.*?</\1>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", shown).split())


class Links(HTMLParser):
    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [v for name, v in attrs if tag == "a" and name == "href" and v]


@pytest.mark.parametrize("place", ["results", "far/away"])
def test_every_page_that_was_kept_is_reached(index, place):
    bench = index.parent.parent
    page = written(bench, bench / place)
    targets = [target for target in Links(page).targets if target != "runs.csv"]
    assert len(targets) == 2 * 24 - 1  # of the first seeds, but for the corrupt run
    assert all((page.parent / unquote(target)).exists() for target in targets)


def test_the_page_says_what_its_figures_mean_and_what_is_missing(index):
    shown = words(index.read_text())
    assert "A step in which nothing should sound and nothing does counts as 1" in shown
    assert "1 run cannot be read, and is left out." in shown
    for group in ("All pieces 24 pieces", "library-1 12 pieces", "library-2 12 pieces"):
        assert group in shown


def test_the_table_has_the_means_of_each_piece_and_agent(tmp_path):
    for piece, agent, seed, f1 in (("a", "one", 0, 0.5), ("a", "one", 1, 0.7), ("b", "two", 0, 1)):
        name = f"{piece} {agent} {seed}"
        write_result(tmp_path, name, result(piece, agent, seed, {"f1": f1}, title=f"Piece {piece}"))
    shown = words(written(tmp_path).read_text())
    assert "Piece a made-up 3.0 20 60 one – – 0.600 0.000 to 1.000 –" in shown
    assert "Piece b made-up 3.0 20 60 two – – 1.000 –" in shown


def test_the_page_stands_alone(index):
    text = index.read_text().replace("http://www.w3.org/2000/svg", "")
    assert not re.search(r"https?://|src=|<link rel=\"stylesheet|@import|url\(", text)
    assert "{{" not in text


def test_words_of_others_are_escaped(tmp_path):
    song = {"title": BAD, "composer": BAD, "library": BAD}
    for i, name in enumerate((BAD, "..")):
        content = result(name, BAD, 0, {"f1": 0.5}, **song)
        content["versions"]["mujoco"] = f"{BAD}{i}"
        (write_result(tmp_path, f"run {i} #", content) / "report.html").touch()
    page = written(tmp_path).read_text()
    assert BAD not in page
    assert "<i>" not in page
    assert "run%200%20%23--" in page


def test_a_single_run_makes_a_page(tmp_path):
    write_result(tmp_path, "only", result("a", "planner", 0, {"f1": 0.5}))
    shown = words(written(tmp_path).read_text())
    assert "planner – – 0.500 –" in shown
    assert "nan" not in shown.lower()


def test_the_figure_has_a_bar_for_every_piece_and_agent(index, tmp_path):
    write_figure(tmp_path / "f.svg", summarize(read_results(index.parent.parent), "x"))
    picture = ET.parse(tmp_path / "f.svg").getroot()
    bars = [element for element in picture.iter() if element.get("class") == "bar"]
    assert len(bars) == 48
    heights = [float(bar.get("height", "")) for bar in bars[:24]]
    assert heights == sorted(heights, reverse=True)
    assert {"planner", "ilqg"} <= {text.text for text in picture.iter() if text.text}


def test_the_figure_of_one_piece_has_a_bar_for_every_agent(tmp_path):
    for agent, onsets in (("low", 0.25), ("high", 0.75)):
        metrics = {"f1": 0.5, "note_onset_f1": onsets}
        write_result(tmp_path, agent, result("a", agent, 0, metrics))
    write_figure(tmp_path / "f.svg", summarize(read_results(tmp_path), "x"))
    picture = ET.parse(tmp_path / "f.svg").getroot()
    bars = [element for element in picture.iter() if element.get("class") == "bar"]
    high, low = (float(bar.get("height", "")) for bar in bars)
    assert high == pytest.approx(3 * low)


# In a browser


def opened(browser: Browser, page: Path, width: int = 1280, height: int = 720) -> None:
    screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.call("Emulation.setDeviceMetricsOverride", **screen)
    browser.events.clear()
    browser.call("Page.navigate", url=page.as_uri())
    browser.wait("document.readyState === 'complete'")
    browser.settle()


def column(browser: Browser, number: int) -> list[str]:
    """The first line of each cell in a column of the table of pieces."""
    cells = f"document.querySelectorAll('.rows tbody tr > :nth-child({number})')"
    return browser.evaluate(f"[...{cells}].map((cell) => cell.firstChild.textContent)")


@pytest.mark.slow
@needs_chromium
def test_the_table_is_sorted_by_a_click_and_backwards_by_another(browser, index):
    opened(browser, index)
    assert browser.evaluate("document.querySelector('.rows [aria-sort]')") is None
    sort = "document.querySelectorAll('.rows thead button')[{}].click()"
    browser.evaluate(sort.format(2))
    difficulty = [float(value) for value in column(browser, 3)]
    assert len(difficulty) == 48
    assert difficulty == sorted(difficulty, reverse=True)
    browser.evaluate(sort.format(2))
    assert [float(value) for value in column(browser, 3)] == difficulty[::-1]
    chosen = "document.querySelector('.rows [aria-sort]').getAttribute('aria-sort')"
    assert browser.evaluate(chosen) == "ascending"
    assert browser.problems() == []
    assert [url for url in browser.loaded() if not url.startswith(("file:", "data:"))] == []


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_page_fits_every_screen(browser, index, scheme):
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.call("Emulation.setEmulatedMedia", features=[feature])
    for width, height in SIZES:
        opened(browser, index, width, height)
        assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert browser.problems() == []


@pytest.mark.slow
@needs_chromium
def test_a_large_bench_is_drawn_and_opened_quickly(browser, tmp_path):
    write_bench(tmp_path, pieces=150, agents=AGENTS, seeds=3)
    began = time.process_time()
    index = written(tmp_path)
    assert time.process_time() - began < 30
    opened(browser, index)
    assert len(column(browser, 1)) == 150 * len(AGENTS)
    assert index.stat().st_size < 2_000_000
