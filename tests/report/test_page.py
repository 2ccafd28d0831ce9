import base64
import json
from html.parser import HTMLParser

import numpy as np
import pytest
from conftest import make_episode

from cadenza.episode import Episode
from cadenza.report.page import write_report

SILENCE = np.zeros((0, 2), np.float32)


class Page(HTMLParser):
    """What a browser would find in the file."""

    def __init__(self, path):
        super().__init__()
        self.elements, self.words, self.data, self._in = [], [], "", ("", {})
        self._broken = False
        self.size = path.stat().st_size
        self.feed(path.read_text("utf-8"))
        self.recording = json.loads(self.data)

    def handle_starttag(self, tag, attrs):
        if tag == "wbr":  # a place to break a line, within a text
            self._broken = True
            return
        self._in = (tag, dict(attrs))
        self.elements.append(self._in)

    def handle_endtag(self, _tag):
        self._in = ("", {})

    def handle_data(self, data):
        tag, attributes = self._in
        if attributes.get("id") == "data":
            self.data += data
        elif tag not in ("script", "style"):
            self.words.append((self.words.pop() if self._broken else "") + data.strip())
            self._broken = False

    def array(self, name, dtype):
        return np.frombuffer(base64.b64decode(self.recording[name]), dtype)


@pytest.fixture
def write(tmp_path):
    def written(episode, metrics=None, settings=None):
        write_report(tmp_path / "a.html", episode, metrics or {}, settings or {}, SILENCE)
        return Page(tmp_path / "a.html")

    return written


def test_what_was_recorded_is_in_the_page(write, episode):
    page = write(episode)
    poses = page.array("poses", "<i2").reshape(episode.num_steps, -1, 7)
    assert np.abs(poses[..., :3] * 1e-4 - episode["body_xpos"]).max() < 0.6e-4
    assert np.abs(poses[..., 3:] / 32767 - episode["body_xquat"]).max() < 1e-4
    states = page.array("states", np.uint8).reshape(episode.num_steps, 88)
    goal, played = episode["goal_keys"], episode["key_activation"]
    assert np.array_equal(states == 1, goal & played)
    assert np.array_equal(states == 2, ~goal & played)
    assert np.array_equal(states == 3, goal & ~played)
    assert page.recording["rewards"]["key_press"] == pytest.approx(
        episode["reward_key_press"], abs=1e-4
    )


def test_the_figures_and_settings_are_in_the_page(write, episode):
    metrics = {"precision": 0.5, "f1": 0.98321, "notes": 42}
    page = write(episode, metrics, {"agent": "planner", "seed": 7, "task": {"lookahead": 10}})
    for word in ("A made-up walk", "F1", "0.983", "42", "planner", "7", "task.lookahead", "10"):
        assert word in page.words
    assert page.words.index("F1") < page.words.index("Precision")


def test_what_was_missed_is_in_the_page(tmp_path, episode):
    misses = [
        {"time": 1.25, "note": "C♯4", "finger": 7, "what": "never sounded", "reason": "<too fast>"},
        {"time": 2.0, "note": "D4", "finger": -1, "what": "100 ms late", "reason": "no finger"},
    ]
    write_report(tmp_path / "a.html", episode, {}, {}, SILENCE, misses=misses)
    words = [word for word in Page(tmp_path / "a.html").words if word]
    first = words.index("1.25 s")
    assert words[first : first + 5] == [
        "1.25 s",
        "C♯4",
        "left middle",
        "never sounded",
        "<too fast>",
    ]
    assert words[first + 5 : first + 8] == ["2.00 s", "D4", "–"]


def test_the_page_loads_nothing_from_elsewhere(write, episode):
    page = write(episode)
    for tag, attributes in page.elements:
        assert tag not in ("iframe", "object", "embed", "base"), tag
        for name in ("src", "href", "srcset", "data", "poster", "action"):
            assert (attributes.get(name) or "data:").startswith("data:"), (tag, attributes)
    policy = next(
        a["content"] for _, a in page.elements if a.get("http-equiv") == "Content-Security-Policy"
    )
    assert "default-src 'none'" in policy
    assert "http" not in policy


def test_text_cannot_become_markup(write):
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(1)>{{js}}"
    before = write(make_episode()).elements
    page = write(make_episode(song=evil), {evil: 0.5}, {evil: evil, "agent": evil})
    assert {tag for tag, _ in page.elements} <= {tag for tag, _ in before} | {
        "i",
        "dl",
        "dt",
        "dd",
        "tr",
        "th",
        "td",
    }
    assert [a for tag, a in page.elements if tag == "script"] == [
        a for tag, a in before if tag == "script"
    ]
    assert page.words.count(evil) >= 4  # title, heading, settings: all as text


def test_not_a_number_is_shown_as_a_dash(write, episode):
    episode.arrays["reward_key_press"][3] = np.nan
    page = write(episode, {"f1": float("nan"), "worst": float("-inf"), "none": None})
    assert page.words.count("–") == 3
    assert page.recording["rewards"]["key_press"][3] is None


def test_settings_that_are_none_are_not_shown(write, episode):
    page = write(episode, settings={"task": {"limit": None, "steps": 3}, "zero": 0, "no": False})
    assert "task.limit" not in page.words
    assert "None" not in page.words
    assert {"task.steps", "3", "zero", "0", "no", "False"} <= set(page.words)


def test_a_zero_has_no_minus(write, episode):
    page = write(episode, {"f1": -0.0, "energy": -0.0, "loss": -0.5})
    assert {"0.000", "0", "-0.5"} <= set(page.words)
    assert not {"-0.000", "-0"} & set(page.words)


def test_a_minute_is_small(write):
    short = make_episode(steps=1200)
    many = np.random.default_rng(0).uniform(-1, 1, (1200, 52, 7)).astype(np.float32)
    poses = {"body_xpos": many[..., :3], "body_xquat": many[..., 3:]}
    scene = {"bodies": [str(i) for i in range(52)], "geoms": [], "keys": short.scene["keys"]}
    assert write(Episode("a minute", 0.05, {**short.arrays, **poses}, scene)).size < 4e6
