"""The pages that sum up many runs."""

from __future__ import annotations

import re
import time
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

from cadenza.evaluation.results import read_results
from cadenza.evaluation.summary import summarize
from cadenza.report.bench_summary import METRICS
from cadenza.report.results_pages import write_figure, write_results_pages
from evaluation.made_up import AGENTS, result, write_bench, write_result
from headless import Browser, needs_chromium

BAD = "<i>\"&'/../x"
SIZES = ((1440, 900), (1280, 720), (390, 844))


def write_pages(bench: Path, folder: Path | None = None) -> Path:
    """Gives index.html."""
    folder = folder or bench / "results"
    summary = summarize(read_results(bench), bench.name)
    index, *_ = write_results_pages(folder, summary, ["runs.csv"])
    return index


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    bench = tmp_path_factory.mktemp("bench")
    write_bench(bench, pieces=24, agents=("planner", "ilqg"), seeds=3, libraries=2)
    (run,) = (bench / "runs").glob("000--ilqg--s0--*")
    (run / "result.json").write_text("{")
    return write_pages(bench)


def words(page: str) -> str:
    shown = re.sub(r"<(style|title|script)\b.*?</\1>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", shown).split())


class Links(HTMLParser):
    def __init__(self, page: Path) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.targets += [value for name, value in attrs if name == "href" and value]


def test_all_links_lead_somewhere(index: Path) -> None:
    pages = [index, *sorted((index.parent / "pieces").iterdir())]
    assert len(pages) == 25
    for page in pages:
        for target in Links(page).targets:
            if target not in ("data:,", "runs.csv"):
                assert (page.parent / unquote(target)).exists(), target
    addresses = re.findall(r'"(\.\./runs/[^"]*report\.html|pieces/[^"]*\.html)"', index.read_text())
    assert len(addresses) == 24 + 2 * 24 - 1
    assert all((index.parent / unquote(address)).exists() for address in addresses)


def test_pages_elsewhere_lead_to_the_runs(index: Path, tmp_path: Path) -> None:
    other = write_pages(index.parent.parent, tmp_path / "far" / "away")
    (page,) = other.parent.glob("pieces/*_003.html")
    (address,) = {t for t in Links(page).targets if "planner" in t}
    assert (page.parent / unquote(address)).exists()


def test_a_piece_tells_of_every_run_and_of_those_without_a_page(index: Path) -> None:
    (page,) = index.parent.glob("pieces/*_000.html")
    shown = words(page.read_text())
    assert shown.count("no page was kept") == 4  # seeds 1 and 2 of either agent
    assert shown.count("piano roll and 3D") == 1  # the other page is of the corrupt run
    assert shown.count("seed ") == 5
    assert "mean of planner" in shown


def test_the_page_says_what_its_figures_mean_and_what_is_missing(index: Path) -> None:
    shown = words(index.read_text())
    assert "A step in which nothing should sound and nothing does counts as 1" in shown
    assert "1 run cannot be read, and is left out." in shown
    assert "planner, the best of 2 agents: mean of 24 pieces" in shown
    for group in ("All pieces 24 pieces", "library-1 12 pieces", "library-2 12 pieces"):
        assert group in shown


def test_pages_stand_alone(index: Path) -> None:
    for page in (index, *index.parent.glob("pieces/*.html")):
        text = page.read_text()
        assert not re.search(r"https?://|src=|<link rel=\"stylesheet|@import|url\(", text)
        assert "{{" not in text


def test_words_of_others_are_escaped_and_stay_in_the_folder(tmp_path: Path) -> None:
    bench = tmp_path / "bench"
    song = {"title": BAD, "composer": BAD, "library": BAD}
    for i, name in enumerate((BAD, "A/b", "a_b", "..")):
        content = result(name, BAD, 0, {"f1": 0.5}, **song)
        content["versions"]["mujoco"] = f"{BAD}{i}"
        (write_result(bench, f"run {i} #", content) / "report.html").touch()
    index = write_pages(bench)
    pages = sorted((index.parent / "pieces").iterdir())
    assert len(pages) == 4
    assert {path.name for path in tmp_path.iterdir()} == {"bench"}
    for page in (index, *pages):
        assert BAD not in page.read_text()
        assert "<i>&#34;" not in page.read_text()
    assert "run%200%20%23--" in index.read_text()


def test_a_single_run_makes_a_page(tmp_path: Path) -> None:
    write_result(tmp_path, "only", result("a", "planner", 0, {"f1": 0.5}))
    shown = words(write_pages(tmp_path).read_text())
    assert "planner: mean of 1 piece" in shown
    assert "nan" not in shown.lower()


def test_the_figure_has_a_bar_for_every_piece_and_agent(index: Path, tmp_path: Path) -> None:
    write_figure(tmp_path / "f.svg", summarize(read_results(index.parent.parent), "x"))
    picture = ET.parse(tmp_path / "f.svg").getroot()
    bars = [element for element in picture.iter() if element.get("class") == "bar"]
    assert len(bars) == 48
    heights = [float(bar.get("height", "")) for bar in bars[:24]]
    assert heights == sorted(heights, reverse=True)
    assert {"planner", "ilqg"} <= {text.text for text in picture.iter() if text.text}


def test_no_chart_is_without_a_line(tmp_path: Path) -> None:
    """A chart without one would stop the scripts of the page."""
    write_result(tmp_path, "only", result("a", "planner", 0, {"f1": 0.5}))  # no other metric
    page = write_pages(tmp_path).read_text()
    assert page.count('class="curves"') == page.count('"kind":"run0"') == 1


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
    cells = f"document.querySelectorAll('#pieces tbody tr > :nth-child({number})')"
    return browser.evaluate(f"[...{cells}].map((cell) => cell.firstChild.textContent)")


def press(browser: Browser, key: str) -> None:
    code = {"Enter": 13}.get(key, 0)
    text = {"text": "\r"} if key == "Enter" else {}
    down = {"type": "keyDown", "key": key, "code": key, "windowsVirtualKeyCode": code} | text
    browser.call("Input.dispatchKeyEvent", **down)
    browser.call("Input.dispatchKeyEvent", type="keyUp", key=key, code=key)


def choose(browser: Browser, name: str, option: int) -> None:
    browser.evaluate(f"""(() => {{ const select = document.getElementById("{name}");
        select.value = {option}; select.dispatchEvent(new Event("change")); }})()""")
    browser.settle()


@pytest.mark.slow
@needs_chromium
def test_the_table_is_sorted_and_searched(browser: Browser, index: Path) -> None:
    opened(browser, index)
    f1 = [float(value) for value in column(browser, 6)]
    assert len(f1) == 24
    assert f1 == sorted(f1, reverse=True)
    sort = "document.querySelectorAll('#pieces thead button')[{}].click()"
    browser.evaluate(sort.format(2))
    difficulty = [float(value) for value in column(browser, 3)]
    assert difficulty == sorted(difficulty)
    browser.evaluate(sort.format(2))
    assert [float(value) for value in column(browser, 3)] == difficulty[::-1]
    chosen = "document.querySelector('#pieces [aria-sort]')"
    assert browser.evaluate(f"{chosen}.getAttribute('aria-sort')") == "descending"
    assert browser.evaluate(f"{chosen}.contains(document.activeElement)")
    browser.evaluate("document.getElementById('search').focus()")
    browser.call("Input.insertText", text="BEETHOVEN elise library-2")
    found = column(browser, 1)
    assert 0 < len(found) < 12
    assert all(title.startswith("Für Elise") for title in found)
    assert (
        browser.evaluate("document.getElementById('found').value") == f"{len(found)} of 24 pieces"
    )
    assert browser.problems() == []
    assert [url for url in browser.loaded() if not url.startswith(("file:", "data:"))] == []


@pytest.mark.slow
@needs_chromium
def test_choices_change_charts_and_table(browser: Browser, index: Path) -> None:
    opened(browser, index)
    title = "document.getElementById('columns-title').textContent"
    charts = "[...document.querySelectorAll('.profile')].filter((chart) => !chart.hidden).length"
    assert browser.evaluate(title) == "Every piece: F1, planner"
    assert browser.evaluate(charts) == 1
    planner, ilqg = column(browser, 6), column(browser, 7)
    choose(browser, "agent", 1)
    assert browser.evaluate(title) == "Every piece: F1, ilqg"
    assert sorted(column(browser, 7)) == sorted(ilqg)
    choose(browser, "group", 2)
    assert len(column(browser, 1)) == 12
    assert set(column(browser, 2)) == {"library-2"}
    choose(browser, "metric", list(METRICS).index("wall_per_music"))
    assert browser.evaluate(charts) == 0  # times have no profile
    assert set(column(browser, 6)) == {"0.40"}
    choose(browser, "group", 0)
    choose(browser, "metric", 0)
    choose(browser, "agent", 0)
    assert column(browser, 6) == planner
    browser.evaluate("document.querySelector('[data-columns=metrics]').click()")
    titles = "[...document.querySelectorAll('#pieces thead th')].map((th) => th.textContent)"
    assert "Note onset F1" in browser.evaluate(titles)
    assert browser.problems() == []


@pytest.mark.slow
@needs_chromium
def test_a_bar_leads_to_its_piece_by_keys(browser: Browser, index: Path) -> None:
    opened(browser, index)
    browser.evaluate("document.querySelector('#columns .u-over').focus()")
    press(browser, "Home")
    press(browser, "ArrowRight")
    second = browser.evaluate(
        "document.querySelector('#columns .u-legend .u-value').textContent.trim()"
    )
    assert second == column(browser, 1)[1]
    press(browser, "Enter")
    browser.wait("location.pathname.includes('/pieces/')")
    browser.wait("document.readyState === 'complete'")
    assert browser.evaluate("document.querySelector('h1').textContent") == second


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_every_screen(browser: Browser, index: Path, scheme: str) -> None:
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.call("Emulation.setEmulatedMedia", features=[feature])
    (piece,) = index.parent.glob("pieces/*_003.html")
    for width, height in SIZES:
        for page in (index, piece):
            opened(browser, page, width, height)
            assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
            assert browser.problems() == []
        opened(browser, index, width, height)
        assert browser.colliding_labels("#scatter canvas, .profile:not([hidden]) canvas") == []


@pytest.mark.slow
@needs_chromium
def test_a_large_bench_is_drawn_and_opened_quickly(browser: Browser, tmp_path: Path) -> None:
    write_bench(tmp_path, pieces=150, agents=AGENTS, seeds=3)
    began = time.process_time()
    index = write_pages(tmp_path)
    assert time.process_time() - began < 30
    began = time.monotonic()
    opened(browser, index)
    assert time.monotonic() - began < 3
    assert len(column(browser, 1)) == 150
    assert index.stat().st_size < 1_000_000
