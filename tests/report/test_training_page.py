"""The page of learning curves, and figures for TensorBoard and Weights & Biases."""

import html
import json
import math
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cadenza.errors import CadenzaError
from cadenza.installing import install_line
from cadenza.report.html_pages import write_page
from cadenza.report.training_page import Curve, TensorBoard, WeightsAndBiases, training_page
from headless import Browser, needs_chromium

STEPS = "F1"
Row = dict[str, float | None]


def learning(step: int, **train: float | None) -> Row:
    return {"step": step} | {f"train/{name}": value for name, value in train.items()}


def evaluation(step: int, of: int, f1: float, **figures: float | None) -> Row:
    row: Row = {"step": step, "eval_step": of, "eval/f1": f1}
    row["eval/note_onset_f1"] = 0.8 * f1
    return row | {f"eval/{name}": value for name, value in figures.items()}


F1 = {1000: 0.1, 2000: 0.4, 3000: 0.85, 4000: 0.7}
RUN = Curve(
    "fast, seed 0",
    [
        learning(1000, critic_loss=None, value=None),
        learning(2000, critic_loss=7.0, value=math.nan),
        evaluation(2000, 1000, F1[1000], **{"return": 3.0}),
        learning(3000, critic_loss=0.5, value=-2.0),
        evaluation(3000, 2000, F1[2000], **{"return": None}),
        learning(4000, critic_loss=0.03, value=9.0),
        evaluation(4000, 3000, F1[3000], **{"return": 5.0}),
        learning(5000, critic_loss=0.003, value=11.5),
        evaluation(5000, 4000, F1[4000], **{"return": 7.0}),
    ],
)


def charts(page: str) -> dict[str, dict]:
    """Title -> what is given to be drawn."""
    charts = re.findall(r'class="plot"><h3>(.*?)</h3>.*?json">(.*?)</script>', page, re.DOTALL)
    return {html.unescape(title): json.loads(chart) for title, chart in charts}


def lines(page: str, title: str) -> dict[str, list[tuple[float, float]]]:
    """Kind -> (x, y) of the points of each line of a chart."""
    return {
        line["kind"]: list(zip(line["x"], line["y"], strict=True))
        for line in charts(page)[title]["lines"]
    }


@pytest.fixture
def written(tmp_path):
    def write(*runs: Curve, title: str = "A song", **more) -> str:
        path = tmp_path / "training.html"
        write_page(path, training_page(title, runs, more.pop("settings", {}), **more))
        return path.read_text()

    return write


def words(page: str) -> str:
    shown = re.sub(r"<(style|title|script)\b.*?</\1>|<wbr>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", shown).split())


def assert_drawn(drawn: Sequence[tuple[float, float]], expected: Sequence) -> None:
    np.testing.assert_allclose(drawn, expected, rtol=1e-5)


def test_f1_is_drawn_at_the_steps_that_its_policies_are_of(written):
    page = written(RUN)
    assert_drawn(lines(page, STEPS)["run0"], list(F1.items()))
    onsets = [(step, 0.8 * f1) for step, f1 in F1.items()]
    assert_drawn(lines(page, "Note onset F1")["run0"], onsets)


def test_what_is_not_known_is_left_out(written):
    page = written(RUN)
    assert_drawn(lines(page, "Return")["run0"], [(1000, 3), (3000, 5), (4000, 7)])
    assert_drawn(lines(page, "Value")["run0"], [(3000, -2), (4000, 9), (5000, 11.5)])
    assert "Entropy" not in charts(page)


def test_the_critics_loss_is_drawn_by_its_logarithm(written):
    page = written(RUN)
    assert charts(page)["Critic loss"]["y"] == "log"
    drawn = lines(page, "Critic loss")["run0"]
    assert_drawn(drawn, [(2000, 7), (3000, 0.5), (4000, 0.03), (5000, 0.003)])


def test_the_mean_of_runs_is_drawn_where_all_of_them_are(written):
    early = Curve("early", [evaluation(s + 1000, s, f) for s, f in ((1000, 0.2), (3000, 0.6))])
    late = Curve("late", [evaluation(s + 1000, s, f) for s, f in ((2000, 0.8), (4000, 1.0))])
    unborn = Curve("without an evaluation", [learning(1000)])
    drawn = lines(written(early, late, unborn), STEPS)
    assert_drawn(drawn["mean"], [(2000, 0.6), (3000, 0.75)])
    assert_drawn(drawn["run0"], [(1000, 0.2), (3000, 0.6)])
    assert_drawn(drawn["run1"], [(2000, 0.8), (4000, 1.0)])
    assert "mean" not in lines(written(early, unborn), STEPS)


def test_runs_of_several_songs_are_left_apart(written):
    low, high = (
        Curve(f"joy {i}", [evaluation(s + 1000, s, f1) for s in (1000, 3000)], "joy")
        for i, f1 in ((0, 0.2), (1, 0.6))
    )
    other = Curve("elise 0", [evaluation(3000, 2000, 0.9), evaluation(9000, 8000, 0.95)], "elise")
    page = written(low, other, high)
    drawn = lines(page, STEPS)
    assert set(drawn) == {"run0", "run1"}
    assert_drawn(drawn["run0"], [(1000, 0.4), (3000, 0.4)])
    assert_drawn(drawn["run1"], [(2000, 0.9), (8000, 0.95)])
    of_several, of_one = charts(page)[STEPS]["lines"]
    assert_drawn(of_several["band"], [(0.2, 0.2), (0.6, 0.6)])
    assert "band" not in of_one
    assert "Evaluation joy elise F1" in words(page)  # the legend


def test_the_page_of_a_run_that_goes_on_loads_itself_anew(written):
    assert "location.reload()" in written(RUN, running=True)
    assert "location.reload()" not in written(RUN)


def test_huge_values_neither_hang_nor_hide_the_others(written):
    rows = [learning(s, value=1.0 * s, critic_loss=0.1) for s in (1000, 2000)]
    for huge in (1e308, -1e308, math.inf, 1e29):
        rows.append(learning(2500, value=huge))
        rows.append(evaluation(2600, 2500, 0.5, **{"return": huge}))
    page = written(Curve("wild", [*rows, {"step": 1e308, "train/value": 3.0}]))
    assert_drawn(lines(page, "Value")["run0"], [(1000, 1000), (2000, 2000), (2500, 1e29)])
    assert len(page) < 100_000
    assert "wild" in written(Curve("wild", [{"step": 1e250}]))


def test_without_an_evaluation(written):
    page = written(Curve("begun", [learning(1000, value=2.0)]))
    assert "No evaluation yet." in words(page)
    assert_drawn(lines(page, "Value")["run0"], [(1000, 2)])


@pytest.mark.parametrize("rows", [[], [{"step": 0}]])
def test_a_run_that_has_just_begun(written, rows):
    assert "No evaluation yet." in words(written(Curve("begun", rows), Curve("too", rows)))


def test_what_stays_the_same_is_a_level_line(written):
    rows = [learning(s, value=0.3, critic_loss=0.0, temperature=1.0) for s in (1000, 2000)]
    page = written(Curve("still", rows))
    assert_drawn(lines(page, "Value")["run0"], [(1000, 0.3), (2000, 0.3)])
    assert_drawn(lines(page, "Temperature")["run0"], [(1000, 1), (2000, 1)])
    assert "Critic loss" not in charts(page)  # a logarithm has no zero


def test_scores_are_drawn_from_0_to_1(written):
    row = evaluation(2000, 1000, 0.0) | {"eval/note_onset_f1": 0.0, "episodes/f1": 0.3}
    page = written(Curve("begun", [row]))
    for title in ("Note onset F1", "F1 of training episodes"):
        assert charts(page)[title]["y"] == "share"


def test_long_runs_make_a_small_page_that_still_shows_them(written):
    rng = np.random.default_rng(0)
    steps = 100 * np.arange(1, 50_001)
    truth = np.sin(steps / 1e6)
    rows: list[Row] = []
    for step, value in zip(
        steps.tolist(), (truth + rng.normal(0, 0.3, len(steps))).tolist(), strict=True
    ):
        rows.append(learning(step, value=value))
        if step % 1000 == 0:
            rows.append(evaluation(step, step - 500, 0.5 + value / 4))
    page = written(*(Curve(f"seed {seed}", rows) for seed in range(5)))
    assert len(page) < 450_000
    x, y = np.array(lines(page, "Value")["run4"]).T
    assert x[0] < 0.02 * steps[-1]
    assert x[-1] > 0.98 * steps[-1]
    assert np.abs(y - np.interp(x, steps, truth)).max() < 0.15


def test_words_of_others_are_escaped(written):
    bad = '<i>"&'
    page = written(
        Curve(bad, RUN.rows),
        Curve(bad, RUN.rows),
        title=bad,
        settings={bad: {bad: bad}},
        links={bad: f"{bad}.html"},
    )
    assert bad not in page
    assert '<i>"' not in page
    assert page.count("&lt;i&gt;&#34;&amp;") > 10
    assert {line["name"] for line in charts(page)[STEPS]["lines"]} > {bad}


def test_settings_and_links(written):
    settings = {"learner": {"rate": 3e-4, "sizes": [256, 256]}, "residual": True, "limit": None}
    page = written(RUN, settings=settings, links={"the best": "best/report.html"})
    assert "Settings learner.rate 0.0003 learner.sizes 256, 256 residual True" in words(page)
    assert "limit" not in words(page)
    assert '<a href="best/report.html">the best</a>' in page
    assert "<details" not in written(RUN)


def test_the_page_stands_alone(written):
    page = written(RUN, RUN)
    assert not re.search(r"https?://|src=|<link rel=\"stylesheet|@import|url\(", page)
    assert "{{" not in page


# In a browser


def opened(browser: Browser, path: Path, width: int = 1000) -> None:
    screen = {"width": width, "height": 1700, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.call("Emulation.setDeviceMetricsOverride", **screen)
    browser.events.clear()
    browser.call("Page.navigate", url=path.as_uri())
    browser.wait("document.readyState === 'complete'")
    browser.settle()


VALUES = (
    "document.querySelector('.u-legend:not([hidden])')?.innerText.replace(/\\s+/g, ' ') ?? null"
)


@pytest.mark.slow
@needs_chromium
def test_values_show_under_the_pointer_the_finger_and_by_keys(written, browser, tmp_path):
    low = Curve("low", [evaluation(s + 1000, s, f1) for s, f1 in ((1000, 0.2), (3000, 0.4))])
    high = Curve("high", [evaluation(s + 1000, s, f1) for s, f1 in ((2000, 0.9), (4000, 0.7))])
    written(low, high)
    opened(browser, tmp_path / "training.html")
    assert browser.evaluate(VALUES) is None
    left, width, y = browser.evaluate(
        "(({ left, width, top }) => [left, width, top + 50])"
        "(document.querySelector('.u-over').getBoundingClientRect())"
    )
    pointer = {"type": "mouseMoved", "x": left + 0.41 * width, "y": y}  # the axis ends at 5000
    browser.call("Input.dispatchMouseEvent", **pointer)
    shown = browser.evaluate(VALUES)
    for words in ("control steps 2,000", "low 0.3", "high 0.9", "mean 0.6"):
        assert words in shown
    browser.call("Input.dispatchMouseEvent", **pointer | {"x": left + 0.79 * width})
    assert "low" not in browser.evaluate(VALUES)  # it ends before
    assert "high 0.7" in browser.evaluate(VALUES)
    browser.call("Input.dispatchMouseEvent", **pointer | {"y": 5})
    assert browser.evaluate(VALUES) is None

    touch = {"touchPoints": [{"x": left + 0.41 * width, "y": y}]}
    browser.call("Input.dispatchTouchEvent", type="touchStart", **touch)
    assert "control steps 2,000" in browser.evaluate(VALUES)
    touch["touchPoints"][0]["x"] = left + 0.61 * width
    browser.call("Input.dispatchTouchEvent", type="touchMove", **touch)
    assert "control steps 3,000" in browser.evaluate(VALUES)
    browser.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    press(browser, "Escape")

    browser.evaluate("document.activeElement.blur()")
    press(browser, "Tab")
    assert "control steps" in browser.evaluate(VALUES)
    for key, steps in (("Home", "1,000"), ("ArrowRight", "2,000"), ("ArrowLeft", "1,000")):
        press(browser, key)
        assert f"control steps {steps}" in browser.evaluate(VALUES)
    press(browser, "Escape")
    assert browser.evaluate(VALUES) is None
    assert browser.problems() == []


def press(browser: Browser, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key=key, code=key)


@pytest.mark.slow
@needs_chromium
def test_labels_do_not_overlap_on_any_screen(written, browser, tmp_path):
    names = ("actor_loss", "policy_loss", "value", "entropy", "kl")
    sizes = dict(zip(names, (1e-29, -1e-9, -12.3, 1e9, 1e29), strict=True))
    wild = [learning(9, **{name: 0.7 * size for name, size in sizes.items()})]
    wild += [learning(2_500_000, **sizes)]
    wild += [evaluation(2_500_000, 2_400_000, 0.45, **{"return": -1234.5})]
    written(RUN, Curve("slow", wild))
    for width in (320, 390, 900, 1300):
        opened(browser, tmp_path / "training.html", width)
        assert browser.evaluate("document.documentElement.scrollWidth") <= width
        assert browser.colliding_labels() == []
        assert browser.problems() == []
        for labels in browser.labels():
            texts = [label for label in labels if label != "0"]
            assert len(set(texts)) == len(texts) > 2


@pytest.mark.slow
@needs_chromium
def test_labels_are_as_people_say_them(written, browser, tmp_path):
    rows = [evaluation(s, s, 0.5, **{"return": s / 1e7 - 0.4}) for s in (10_000, 900_000)]
    rows += [learning(s, critic_loss=loss) for s, loss in ((10_000, 0.003), (900_000, 7.0))]
    written(Curve("a day", rows))
    opened(browser, tmp_path / "training.html")
    steps, _, earned, loss = (set(labels) for labels in browser.labels())
    assert {"0", "200 k", "400 k", "0.5", "1.0", "control steps"} < steps
    assert {"−0.40", "−0.36"} < earned
    assert {"0.01", "0.1", "1", "10"} < loss
    assert not {"0.001", "100"} & loss


@pytest.mark.slow
@needs_chromium
def test_curves_are_where_their_axes_say_and_change_with_the_colour_scheme(
    written, browser, tmp_path
):
    rows = [learning(s, value=v) for s, v in ((0, 0.0), (1000, 8.0), (2000, 0.0))]
    written(Curve("a peak", rows))
    for scheme, colour in (("light", (0x2F, 0x5B, 0xD7)), ("dark", (0x86, 0xA8, 0xFF))):
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        browser.call("Emulation.setEmulatedMedia", features=features)
        if scheme == "light":
            opened(browser, tmp_path / "training.html")
        picture = browser.picture(".u-over").astype(int)
        line = np.argwhere(np.abs(picture - colour).max(axis=2) < 24)
        height, width = picture.shape[:2]
        top, left = line[line[:, 0].argmin()] / (height, width)
        assert left == pytest.approx(0.5, abs=0.02)
        assert top < 0.2
        ends = line[(line[:, 1] < 4) | (line[:, 1] > width - 4), 0]
        assert ends.min() > 0.8 * height


def test_a_run_of_weights_and_biases_goes_by_its_id(tmp_path, monkeypatch):
    """And not by the name of its folder, which others have too."""
    asked: list[dict[str, Any]] = []
    logged: list[dict[str, float]] = []
    run = SimpleNamespace(log=logged.append, finish=lambda: None)
    fake = SimpleNamespace(init=lambda **options: asked.append(options) or run)
    monkeypatch.setitem(sys.modules, "wandb", fake)
    scalars = WeightsAndBiases("project", tmp_path / "a" / "run", "0123", {"seed": 1})
    scalars.add({"step": 5, "seconds": 1.0})
    scalars.close()
    assert asked == [
        {
            "project": "project",
            "dir": str(tmp_path / "a" / "run"),
            "id": "0123",
            "resume": "allow",
            "config": {"seed": 1},
        }
    ]
    assert logged == [{"seconds": 1.0, "control_steps": 5}]


def test_nobody_knows_the_name_of_the_next_file(tmp_path):
    """It would be written through a link of that name."""
    for _ in range(3):
        TensorBoard(tmp_path, 0).close()
    names = [path.name for path in tmp_path.iterdir()]
    assert len({name.rsplit(".", 1)[1] for name in names}) == 3


def test_packages_that_are_missing_are_told_with_how_to_install_them(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboardX", None)  # importing it fails
    with pytest.raises(CadenzaError, match=f"training needs .*{re.escape(install_line('train'))}"):
        TensorBoard(tmp_path, 0)
