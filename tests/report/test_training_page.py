"""The page of learning curves; its drawings are read back by means of their own labels."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from headless import Browser, needs_chromium
from hypothesis import given
from hypothesis import strategies as st

from cadenza.report.line_chart import LARGEST, Axis, count_axis, log_axis, time_axis, value_axis
from cadenza.report.training import Curve, write_training

UNITS = {"": 1, "k": 1e3, "M": 1e6, "s": 1, "min": 60, "h": 3600}
STEPS, TIME = "F1 by control steps", "F1 by wall time"
LOGARITHMIC = ("Critic loss", "Temperature")
Row = dict[str, float | None]


def learning(step: int, **train: float | None) -> Row:
    """A row of training at ten steps a second."""
    figures = {f"train/{name}": value for name, value in train.items()}
    return {"step": step, "seconds": step / 10, "updates": step // 5} | figures


def evaluation(step: int, of: int, f1: float, **figures: float | None) -> Row:
    row: Row = {"step": step, "seconds": step / 10, "eval_step": of, "eval/f1": f1}
    ratios: Row = {"eval/precision": min(f1 + 0.1, 1), "eval/recall": 0.9 * f1}
    return row | ratios | {f"eval/{name}": value for name, value in figures.items()}


F1 = {1000: 0.1, 2000: 0.4, 3000: 0.85, 4000: 0.7}
RUN = Curve(
    "fast, seed 0",
    [
        learning(1000, critic_loss=None, value=None),
        learning(2000, critic_loss=7.0, value=math.nan),
        evaluation(2000, 1000, F1[1000], **{"reward/key_press": 3.0}),
        learning(3000, critic_loss=0.5, value=-2.0),
        evaluation(3000, 2000, F1[2000], **{"reward/key_press": None}),
        learning(4000, critic_loss=0.03, value=9.0),
        evaluation(4000, 3000, F1[3000], **{"reward/key_press": 5.0}),
        learning(5000, critic_loss=0.003, value=11.5),
        evaluation(5000, 4000, F1[4000], **{"reward/key_press": 7.0}),
    ],
)


class Charts(HTMLParser):
    """Title -> what is drawn: class -> (x, y) of the points, by the labels of the axes."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.found: dict[str, dict[str, list[tuple[float, float]]]] = {}
        self._texts: list[str] = []
        for section in re.findall(r'<section class="plot">.*?</section>', page, re.DOTALL):
            self._labels: dict[str, list[tuple[float, float]]] = {"left": [], "bottom": []}
            self._paths: list[tuple[str, str]] = []
            self._side: tuple[str, float] | None = None
            self._texts.clear()
            self.feed(section)
            x, y = (self._scale(side) for side in ("left", "bottom"))
            self.found[self._texts[0]] = {
                kind: [
                    (x(float(i) / 10), y(100 - float(j) / 10))
                    for i, j in re.findall(r"[ML]([-\d.]+) ([-\d.]+)", path)
                ]
                for kind, path in self._paths
                if kind != "grid"
            }

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if tag == "path":
            self._paths.append((given["class"], given["d"]))
        elif tag == "span":
            side, share = given["style"].rstrip("%").split(":")
            self._side = side, float(share)

    def handle_data(self, data: str) -> None:
        self._texts.append(data)
        if self._side:
            number, _, unit = data.replace("−", "-").partition(" ")
            self._labels[self._side[0]].append((self._side[1], float(number) * UNITS[unit]))
            self._side = None

    def _scale(self, side: str) -> Callable[[float], float]:
        """Percent of the axis -> value; all its labels have to agree."""
        shares, values = np.array(self._labels[side]).T
        log = side == "bottom" and self._texts[0] in LOGARITHMIC
        slope, start = np.polyfit(shares, np.log(values) if log else values, 1)

        def scale(share: float) -> float:
            return math.exp(slope * share + start) if log else slope * share + start

        np.testing.assert_allclose(
            [scale(share) for share in shares], values, rtol=1e-2, atol=np.ptp(values) / 1e4
        )
        return scale


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., str]:
    def write(*runs: Curve, title: str = "A song", **more) -> str:
        path = tmp_path / "training.html"
        write_training(path, title, runs, more.pop("settings", {}), **more)
        return path.read_text()

    return write


def words(page: str) -> str:
    shown = re.sub(r"<(style|title|script)>.*?</\1>", "", page, flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", shown).split())


def assert_drawn(drawn: Sequence[tuple[float, float]], expected: Sequence) -> None:
    np.testing.assert_allclose(drawn, expected, rtol=3e-3, atol=2e-3)


def test_f1_is_drawn_at_the_steps_that_its_policies_are_of(written) -> None:
    drawn = Charts(written(RUN)).found[STEPS]
    assert_drawn(drawn["run0"], list(F1.items()))
    assert_drawn(drawn["precision"], [(step, f1 + 0.1) for step, f1 in F1.items()])
    assert_drawn(drawn["recall"], [(step, 0.9 * f1) for step, f1 in F1.items()])
    assert_drawn(drawn["best dots"], [(3000, 0.85)])


def test_f1_is_drawn_at_the_time_when_training_was_there(written) -> None:
    drawn = Charts(written(RUN)).found[TIME]
    assert_drawn(drawn["run0"], [(step / 10, f1) for step, f1 in F1.items()])
    assert_drawn(drawn["best dots"], [(300, 0.85)])


def test_what_is_not_known_is_left_out(written) -> None:
    found = Charts(written(RUN)).found
    assert_drawn(found["Reward: key press"]["run0"], [(1000, 3), (3000, 5), (4000, 7)])
    assert_drawn(found["Value"]["run0"], [(3000, -2), (4000, 9), (5000, 11.5)])
    assert "Entropy" not in found


def test_the_critics_loss_is_drawn_by_its_logarithm(written) -> None:
    drawn = Charts(written(RUN)).found["Critic loss"]["run0"]
    expected = [(2000, 7), (3000, 0.5), (4000, 0.03), (5000, 0.003)]
    np.testing.assert_allclose(drawn, expected, rtol=2e-2)


def test_the_mean_of_runs_is_drawn_where_all_of_them_are(written) -> None:
    early = Curve("early", [evaluation(s + 1000, s, f) for s, f in ((1000, 0.2), (3000, 0.6))])
    late = Curve("late", [evaluation(s + 1000, s, f) for s, f in ((2000, 0.8), (4000, 1.0))])
    unborn = Curve("without an evaluation", [learning(1000)])
    drawn = Charts(written(early, late, unborn)).found[STEPS]
    assert_drawn(drawn["mean"], [(2000, 0.6), (3000, 0.75)])
    assert_drawn(drawn["run0"], [(1000, 0.2), (3000, 0.6)])
    assert_drawn(drawn["run1"], [(2000, 0.8), (4000, 1.0)])
    assert "mean" not in Charts(written(early, unborn)).found[STEPS]


def test_runs_of_several_songs_are_left_apart(written) -> None:
    low, high = (
        Curve(f"joy {i}", [evaluation(s + 1000, s, f1) for s in (1000, 3000)], "joy")
        for i, f1 in ((0, 0.2), (1, 0.6))
    )
    other = Curve("elise 0", [evaluation(3000, 2000, 0.9), evaluation(9000, 8000, 0.95)], "elise")
    page = written(low, other, high)
    drawn = Charts(page).found[STEPS]
    assert_drawn(drawn["run0"], [(1000, 0.4), (3000, 0.4)])
    assert_drawn(drawn["run0 band"], [(1000, 0.2), (3000, 0.2), (3000, 0.6), (1000, 0.6)])
    assert_drawn(drawn["run1"], [(2000, 0.9), (8000, 0.95)])
    assert not {"run2", "mean", "precision", "run1 band"} & set(drawn)
    shown = words(page)
    assert "mean of joy 0.400" in shown
    assert "mean of elise" not in shown
    assert "How well it plays joy elise F1" in shown  # the legend


def test_a_run_that_goes_on_says_how_long_and_loads_itself_anew(written) -> None:
    slow_start = [learning(1000), *(learning(s) for s in (2000, 3000, 4000))]
    slow_start[0]["seconds"] = -900.0
    running = Curve("begun", slow_start, num_steps=64_000)
    page = written(running, going_on=True)
    assert "Control steps 4,000 60 k to go of 64 k" in words(page)
    assert "about 1 h 40 min left" in words(page)  # at ten steps a second
    assert '<html lang="en" data-renewed>' in page
    finished = written(Curve("done", slow_start, num_steps=4000))
    assert "data-renewed>" not in finished
    assert "left" not in words(finished)


def test_huge_values_neither_hang_nor_hide_the_others(written) -> None:
    rows = [learning(s, value=1.0 * s, critic_loss=0.1) for s in (1000, 2000)]
    for huge in (1e308, -1e308, math.inf, 1e299):
        rows.append(learning(2500, value=huge))
        rows.append(evaluation(2600, 2500, 0.5, **{"return": huge}))
    page = written(Curve("wild", [*rows, {"step": 1e308, "seconds": 1e308, "train/value": 3.0}]))
    drawn = Charts(page).found
    assert [x for x, _ in drawn["Value"]["run0"]] == pytest.approx([1000, 2000, 2500], rel=1e-3)
    assert len(page) < 50_000
    assert "wild" in written(Curve("wild", [{"step": 1e250, "seconds": 1e250}]))


def test_the_figures_of_a_run(written) -> None:
    shown = words(written(RUN))
    assert "Best F1 0.850 at step 3,000, after 5 min" in shown
    assert "Last F1 0.700" in shown
    assert "Control steps 5,000 Wall time 8 min Updates 1,000 Steps a second 10" in shown


def test_the_figures_of_several_runs_and_their_means(written) -> None:
    slow = Curve("slow", [evaluation(2_500_000, 2_400_000, 0.45), learning(2_500_000)])
    shown = words(written(RUN, slow, Curve("new", [learning(0)])))
    assert "fast, seed 0 0.850 3,000 5 min 0.700 5,000 8 min 1,000 10" in shown
    assert "slow 0.450 2.4 M 66 h 40 min 0.450 2.5 M 69 h 27 min 500 k 10" in shown
    assert "new – – – – 0 0 s 0 –" in shown
    assert "mean 0.650" in shown


def test_without_an_evaluation(written) -> None:
    page = written(Curve("begun", [learning(1000, value=2.0)]))
    assert "No evaluation yet." in words(page)
    assert_drawn(Charts(page).found["Value"]["run0 dots"], [(1000, 2)])


@pytest.mark.parametrize("rows", [[], [{"step": 0, "seconds": 0.0}]])
def test_a_run_that_has_just_begun(written, rows: list[Row]) -> None:
    assert "Best F1 –" in words(written(Curve("begun", rows)))
    assert "No evaluation yet." in words(written(Curve("begun", rows), Curve("too", rows)))


def test_what_stays_the_same_is_a_level_line(written) -> None:
    rows = [learning(s, value=0.3, critic_loss=0.0, temperature=1.0) for s in (1000, 2000)]
    found = Charts(written(Curve("still", rows))).found
    assert_drawn(found["Value"]["run0"], [(1000, 0.3), (2000, 0.3)])
    assert_drawn(found["Temperature"]["run0"], [(1000, 1), (2000, 1)])
    assert "Critic loss" not in found  # a logarithm has no zero


def test_scores_are_drawn_from_0_to_1(written) -> None:
    row = evaluation(2000, 1000, 0.0) | {"eval/note_onset_f1": 0.0, "episodes/f1": 0.3}
    page = written(Curve("begun", [row]))
    for title in ("Note onset F1", "F1 of training episodes"):
        chart = page[page.index(f"{title}<") :]
        labels = re.findall(r"bottom:[^>]*>([^<]*)<", chart[: chart.index("</section>")])
        assert (labels[0], labels[-1]) == ("0", "1.0")


def test_long_runs_make_a_small_page_that_still_shows_them(written) -> None:
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
    x, y = np.array(Charts(page).found["Value"]["run4"]).T
    assert x[0] < 0.02 * steps[-1]
    assert x[-1] > 0.98 * steps[-1]
    assert np.abs(y - np.interp(x, steps, truth)).max() < 0.15


def test_words_of_others_are_escaped(written) -> None:
    bad = '<i>"&'
    page = written(
        Curve(bad, [*RUN.rows, {"step": 6000, "seconds": 600.0, f"eval/reward/{bad}": 1.0}]),
        Curve(bad, RUN.rows),
        title=bad,
        settings={bad: {bad: bad}},
        links={bad: f"{bad}.html"},
    )
    assert bad not in page
    assert '<i>"' not in page
    assert page.count("&lt;i&gt;&quot;&amp;") > 10


def test_settings_and_links(written) -> None:
    settings = {"learner": {"rate": 3e-4, "sizes": [256, 256]}, "residual": True, "limit": None}
    page = written(RUN, settings=settings, links={"the best": "best/report.html"})
    assert "Settings learner.rate 0.0003 learner.sizes [256, 256] residual True" in words(page)
    assert "limit" not in words(page)
    assert '<a href="best/report.html">the best</a>' in page
    assert "<details" not in written(RUN)


def test_the_page_stands_alone(written) -> None:
    page = written(RUN, RUN)
    assert not re.search(r"https?://|src=|<link rel=\"stylesheet|@import|url\(", page)
    assert "{{" not in page


# Axes

NUMBERS = st.lists(
    st.floats(-LARGEST, LARGEST).filter(lambda x: abs(x) > 1 / LARGEST), min_size=1, max_size=4
)


def assert_holds(axis: Axis, values: np.ndarray) -> None:
    shares, ticks = axis.shares(values), axis.shares(np.array(axis.ticks))
    assert ((shares >= -1e-9) & (shares <= 1 + 1e-9)).all()
    assert ((ticks >= -1e-9) & (ticks <= 1 + 1e-9)).all()
    assert len(set(axis.labels)) == len(axis.ticks)
    assert 1 <= len(axis.ticks) <= 8


@given(NUMBERS)
def test_an_axis_holds_its_values_and_labels_differ(values: list[float]) -> None:
    assert_holds(value_axis(np.array(values)), np.array(values))
    assert_holds(log_axis(np.abs(values)), np.abs(values))


@given(st.floats(1, LARGEST))
def test_an_axis_that_starts_at_zero(high: float) -> None:
    for axis in (count_axis(high), time_axis(high)):
        assert_holds(axis, np.array([0, axis.high]))
        assert axis.labels[0] == "0"


def test_labels_are_as_people_say_them() -> None:
    assert count_axis(5_100_000).labels == ["0", "1 M", "2 M", "3 M", "4 M", "5 M"]
    assert count_axis(900_000).labels == ["0", "200 k", "400 k", "600 k", "800 k"]
    assert time_axis(3600).labels == ["0", "20 min", "40 min", "60 min"]
    assert time_axis(3 * 3600).labels == ["0", "1 h", "2 h", "3 h"]
    assert value_axis(np.array([-0.3, 0.5])).labels == ["−0.4", "−0.2", "0", "0.2", "0.4", "0.6"]
    assert log_axis(np.array([0.003, 7])).labels == ["0.01", "0.1", "1", "10"]


@pytest.mark.slow
@needs_chromium
def test_values_show_under_the_pointer_and_by_keys(written, tmp_path: Path) -> None:
    low = Curve("low", [evaluation(s + 1000, s, f1) for s, f1 in ((1000, 0.2), (3000, 0.4))])
    high = Curve("high", [evaluation(s + 1000, s, f1) for s, f1 in ((2000, 0.9), (4000, 0.7))])
    written(low, high)
    browser = Browser(tmp_path / "profile")
    values = "document.querySelector('.values')?.innerText.replace(/\\s+/g, ' ') ?? null"
    try:
        browser.call("Page.navigate", url=(tmp_path / "training.html").as_uri())
        browser.wait("document.readyState === 'complete'")
        assert browser.evaluate(values) is None
        left, width, y = browser.evaluate(
            "(({ left, width, top }) => [left, width, top + 50])"
            "(document.querySelector('.drawing').getBoundingClientRect())"
        )
        pointer = {"type": "mouseMoved", "x": left + 0.41 * width, "y": y}  # the axis ends at 5000
        browser.call("Input.dispatchMouseEvent", **pointer)
        shown = browser.evaluate(values)
        for words in ("control steps 2,000", "low 0.3", "high 0.9", "mean 0.6"):
            assert words in shown
        browser.call("Input.dispatchMouseEvent", **pointer | {"y": 5})
        assert browser.evaluate(values) is None
        browser.call("Input.dispatchKeyEvent", type="keyDown", key="Tab", code="Tab")
        for key in ("Tab", "ArrowLeft"):
            browser.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=key)
        shown = browser.evaluate(values)
        assert "control steps" in shown or "wall time" in shown
        assert browser.problems() == []
    finally:
        browser.close()


@pytest.mark.slow
@needs_chromium
def test_labels_do_not_overlap_on_any_screen(written, tmp_path: Path) -> None:
    written(RUN, Curve("slow", [evaluation(2_500_000, 2_400_000, 0.45, **{"return": -1234.5})]))
    browser = Browser(tmp_path / "profile")
    try:
        for width in (320, 400, 900, 1300):
            screen = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
            browser.call("Emulation.setDeviceMetricsOverride", **screen)
            browser.call("Page.navigate", url=(tmp_path / "training.html").as_uri())
            browser.wait("document.readyState === 'complete'")
            assert browser.problems() == []
            assert browser.evaluate("document.documentElement.scrollWidth") <= width
            overlaps = browser.evaluate("""
                [...document.querySelectorAll(".xs, .ys")].flatMap(axis => {
                  const boxes = [...axis.children].map(label => label.getBoundingClientRect());
                  return boxes.flatMap((a, i) => boxes.slice(i + 1).filter(b =>
                    a.left < b.right && b.left < a.right && a.top + 3 < b.bottom - 3
                    && b.top + 3 < a.bottom - 3).map(() => axis.textContent));
                })""")
            assert overlaps == []
    finally:
        browser.close()
