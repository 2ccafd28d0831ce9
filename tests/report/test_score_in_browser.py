"""The engraved score of a page, which follows the music."""

import time

import numpy as np
import pytest

from cadenza.fingers import LEFT, RIGHT, Finger
from cadenza.music.score import Bar, Note, Score
from cadenza.report.html_pages import write_page
from cadenza.report.performance_page import performance_page
from headless import needs_chromium

pytestmark = [needs_chromium, pytest.mark.slow]
# Of the made-up performance: the first is hit from 0.2 s on, the second is missed.
NOTES = Note(0.0, 1.0, 60, finger=Finger(LEFT, 1)), Note(1.0, 2.0, 64, finger=Finger(RIGHT, 2))
BARS = Bar(0.0, 1, (0.0, 0.5)), Bar(1.0, 2, (1.0, 1.5))
MARKS = (
    "[...document.querySelectorAll('.note')].map(n => [...n.classList].slice(1).sort().join(' '))"
)


@pytest.fixture
def page(browser, tmp_path, episode):
    silence = np.zeros((0, 2), np.int16)
    made = performance_page(episode, {}, {}, silence, written=Score(NOTES, bars=BARS))
    write_page(tmp_path / "page.html", made)
    browser.open(tmp_path / "page.html")
    return browser


def marks(page, moment):
    page.evaluate(f"cadenza.seek({moment})")
    return page.evaluate(MARKS)


def click(page, selector):
    box = page.evaluate(f"document.querySelector('{selector}').getBoundingClientRect().toJSON()")
    at = {"x": box["x"] + box["width"] / 2, "y": box["y"] + box["height"] / 2}
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **at)
    page.settle()
    return page.evaluate("cadenza.time")


def test_notes_that_sound_are_marked_as_hit_or_missed(page):
    assert marks(page, 0.5) == ["hit sounding", "missed"]
    assert marks(page, 0.1) == ["missed sounding", "missed"]
    assert marks(page, 1.5) == ["", "missed sounding"]
    fingers = "[...document.querySelectorAll('#score .fing')].map(f => f.textContent)"
    assert sorted(page.evaluate(fingers)) == ["2", "3"]
    assert page.problems() == []


def test_clicks_and_keys_go_to_notes_and_bars(page):
    page.evaluate("document.getElementById('score').scrollIntoView()")
    assert click(page, '[data-note="1"] use') == pytest.approx(1.0)
    assert click(page, '[data-note="0"] use') == pytest.approx(0.0)
    page.evaluate("document.getElementById('score').focus()")
    for key, begin in (("PageDown", 1.0), ("PageUp", 0.0)):
        page.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key)
        page.settle()
        assert page.evaluate("cadenza.time") == pytest.approx(begin)


def test_the_cursor_moves_on_with_the_music(page):
    places = []
    for moment in (0.0, 0.5, 1.0, 1.9):
        page.evaluate(f"cadenza.seek({moment})")
        places.append(
            page.evaluate("document.querySelector('#score .cursor').getBoundingClientRect().x")
        )
    assert places == sorted(places)
    assert len(set(places)) == 4


def test_only_whole_systems_are_shown(browser, tmp_path, episode):
    bar = 0.03  # [s]
    bars = tuple(Bar(bar * i, i + 1, (bar * i, bar * (i + 0.5))) for i in range(60))
    notes = tuple(Note(at, at + 0.01, 72) for each in bars for at in each.beats)
    silence = np.zeros((0, 2), np.int16)
    made = performance_page(episode, {}, {}, silence, written=Score(notes, bars=bars))
    write_page(tmp_path / "page.html", made)
    browser.open(tmp_path / "page.html")
    assert browser.evaluate("document.querySelectorAll('.system').length") > 4
    uncut = """(() => {
        const box = (e) => e.getBoundingClientRect(), EDGE = 7;
        const window = box(document.querySelector('#score'));
        const cursor = box(document.querySelector('#score .cursor'));
        const shown = [...document.querySelectorAll('.system:not(.cut)')].map(box);
        const isCurrent = (s) => s.top <= cursor.top && cursor.top < s.bottom;
        return shown.length === 3 && shown.findIndex(isCurrent) === PLACE
            && shown.every((s) => s.top >= window.top - EDGE && s.bottom <= window.bottom + EDGE);
    })()"""
    for moment, place in ((0.1, 0), (0.9, 1), (1.75, 2)):  # the current one in the middle
        browser.evaluate(f"cadenza.seek({moment})")
        browser.settle()
        browser.wait(uncut.replace("PLACE", str(place)), 5)  # it may be scrolling


def test_the_score_is_hidden_and_downloaded(page, tmp_path):
    page.evaluate("document.getElementById('show-score').click()")
    assert not page.evaluate("document.getElementById('score').checkVisibility()")
    page.settle()
    assert page.problems() == []
    page.call("Page.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    for name, part in (("score.musicxml", "<fingering"), ("score.svg", "data-note")):
        page.evaluate(f"document.querySelector('[download=\"{name}\"]').click()")
        wait_for(tmp_path / name)
        assert (tmp_path / name).read_text().count(part) == len(NOTES)


def test_what_is_printed_is_the_title_and_the_score(page):
    page.evaluate("window.print = () => {}")
    page.evaluate("document.querySelector('#downloads button:not(#film)').click()")
    page.call("Emulation.setEmulatedMedia", media="print")
    seen = (
        "['h1', '#score', '#picture', '#roll', '#play']"
        ".map((part) => document.querySelector(part).checkVisibility())"
    )
    assert page.evaluate(seen) == [True, True, False, False, False]
    page.call("Emulation.setEmulatedMedia", media="")
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(seen) == [True] * 5


def wait_for(path):
    end = time.monotonic() + 20
    while not path.exists():
        assert time.monotonic() < end
        time.sleep(0.05)
