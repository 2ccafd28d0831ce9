"""The page of the benchmark's entries, in a browser."""

from __future__ import annotations

from pathlib import Path

from cadenza.report.leaderboard_page import write_leaderboard_page
from headless import Browser, needs_chromium

WIDTH = 1400


@needs_chromium
def test_what_one_entry_says_hides_no_figure_of_another(browser: Browser, tmp_path: Path) -> None:
    """Texts of any length wrap, and letters with a tower of accents stay in their row."""
    path = tmp_path / "index.html"
    long, tower = "W" * 80, "p" + "\u0301" * 79
    rows = [[long, "x" * 400, "0.900"], ["honest", "us", "0.800"], [tower, "us", "0.700"]]
    titles = {"entry": True, "by": True, "F1": False}
    write_leaderboard_page(path, titles, {"bundled, planning": rows})
    screen = {"width": WIDTH, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **screen)
    browser.call("Page.navigate", url=path.as_uri())
    browser.wait("document.readyState === 'complete'")
    right = browser.evaluate(
        "Math.max(...[...document.querySelectorAll('td, th')]"
        ".map((cell) => cell.getBoundingClientRect().right))"
    )
    assert right < WIDTH
    assert (
        browser.evaluate(
            "getComputedStyle(document.querySelector('tbody tr:last-child th')).overflow"
        )
        == "clip"
    )
