import base64
import json
import re
import zlib
from html.parser import HTMLParser

import numpy as np
import pytest
from made_up_episode import make_episode

from cadenza.episode import Episode
from cadenza.music.score import Note, Score
from cadenza.report.engraving import engraving_within
from cadenza.report.html_pages import asset, write_page
from cadenza.report.performance_page import performance_page

SILENCE = np.zeros((0, 2), np.int16)


class Page(HTMLParser):
    """What a browser would find in the file."""

    def __init__(self, path):
        super().__init__()
        self.elements, self.words, self._in = [], [], ("", {})
        self._broken = False
        self.size = path.stat().st_size
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag, attrs):
        if tag == "wbr":  # a place to break a line, within a text
            self._broken = True
            return
        self._in = (tag, dict(attrs))
        self.elements.append(self._in)

    def handle_endtag(self, _tag):
        self._in = ("", {})

    def handle_data(self, data):
        tag, _ = self._in
        if tag not in ("script", "style"):
            self.words.append((self.words.pop() if self._broken else "") + data.strip())
            self._broken = False


@pytest.fixture
def write(tmp_path):
    def written(episode, metrics=None, settings=None):
        page = performance_page(episode, metrics or {}, settings or {}, SILENCE)
        write_page(tmp_path / "a.html", page)
        return Page(tmp_path / "a.html")

    return written


def test_the_figures_and_settings_are_in_the_page(write, episode):
    metrics = {"precision": 0.5, "f1": 0.98321, "notes": 42}
    page = write(episode, metrics, {"agent": "planner", "seed": 7, "task": {"lookahead": 10}})
    for word in ("A made-up walk", "F1", "0.983", "42", "planner", "7", "task.lookahead", "10"):
        assert word in page.words
    assert page.words.index("F1") < page.words.index("Precision")


def test_what_is_not_played_is_at_the_top_of_the_page(write, episode):
    settings = {"agent": "planner", "remarks": ["3 notes are <left> out"]}
    page = write(episode, {"f1": 0.5}, settings)
    assert page.words.count("3 notes are <left> out") == 1
    assert page.words.index("3 notes are <left> out") < page.words.index("F1")
    assert not any("remarks" in word for word in page.words)


def test_what_was_missed_is_in_the_page(tmp_path, episode):
    misses = [
        {"time": 1.25, "note": "C♯4", "finger": 7, "what": "never sounded", "reason": "<too fast>"},
        {"time": 2.0, "note": "D4", "finger": -1, "what": "100 ms late", "reason": "no finger"},
    ]
    misses = [miss | {"cause": "some cause"} for miss in misses]
    page = performance_page(episode, {}, {}, SILENCE, misses=misses)
    write_page(tmp_path / "a.html", page)
    assert "Notes missed or let go early: 2" in Page(tmp_path / "a.html").words
    text = (tmp_path / "a.html").read_text("utf-8")
    data = re.search(r'class="recording">(.*?)</script>', text)
    assert data
    recording = json.loads(zlib.decompress(base64.b64decode(data[1])))
    assert recording["misses"] == [
        [1.25, "C♯4", "left middle", "never sounded", "some cause", "<too fast>"],
        [2.0, "D4", "–", "100 ms late", "some cause", "no finger"],
    ]


def test_an_arrangement_has_figures_of_its_own(write, episode):
    metrics = {"f1": 0.98, "melody_kept": 1.0, "original_f1": 0.61, "notes_moved": 94}
    words = [word for word in write(episode, metrics).words if word]
    for title, value in ("F1 against the original", "0.610"), ("Notes moved", "94"):
        assert words[words.index(title) + 1] == value
    assert "Melody kept" not in [word for word in write(episode, {"f1": 0.98}).words if word]


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
    page = write(episode, {"f1": float("nan"), "worst": float("-inf"), "none": None})
    assert page.words.count("–") == 3


def test_an_empty_list_of_settings_claims_nothing(write, episode):
    page = write(episode, settings={"arrangement": {"tracks": []}})  # these are all tracks
    assert page.words[page.words.index("arrangement.tracks") + 1] == "–"


def test_settings_that_are_none_are_not_shown(write, episode):
    page = write(episode, settings={"task": {"limit": None, "steps": 3}, "zero": 0, "no": False})
    assert "task.limit" not in page.words
    assert "None" not in page.words
    assert {"task.steps", "3", "zero", "0", "no", "False"} <= set(page.words)


def test_a_zero_has_no_minus(write, episode):
    page = write(episode, {"f1": -0.0, "sum": -0.0, "loss": -0.5, "energy": 2.5})
    assert {"0.000", "0", "-0.5", "2.5 J"} <= set(page.words)
    assert not {"-0.000", "-0"} & set(page.words)


def test_a_minute_is_small(write):
    short = make_episode(steps=1200)
    joints = {"hand_qpos": np.random.default_rng(0).normal(0, 0.01, (1200, 46)).cumsum(axis=0)}
    assert write(Episode("a minute", 0.05, {**short.arrays, **joints}, short.scene)).size < 2e6


def test_there_are_at_most_four_headlines_and_the_rest_is_folded(write, episode):
    metrics = {"f1": 0.9, "precision": 0.9, "recall": 0.9, "note_onset_f1": 0.8, "return": 12.5}
    page = write(episode, metrics | {"timing_error": 0.0125, "unstable": False})
    assert sum(a.get("class") == "score" for _, a in page.elements) == 4
    assert page.words.count("0.900") == 3
    folded = page.words.index("All other metrics")
    assert {"Return", "12.5", "Timing error", "0.013 s", "Unstable", "no"} < set(
        page.words[folded:]
    )


def test_no_pedal_no_scores_of_it(write, episode):
    metrics = {"f1": 0.5, "sustain_f1": 0.123}
    assert "0.123" in write(episode, metrics).words
    episode.arrays["goal_sustain"][:] = False
    assert "0.123" not in write(episode, metrics).words


def test_folders_of_this_machine_are_not_shown(write, episode, tmp_path):
    paths = {"output": str(tmp_path / "joy"), "agent": str(tmp_path / "run")}
    words = write(episode, settings=paths | {"song": "OdeToJoy"}).words
    assert {"joy", "run", "OdeToJoy"} <= set(words)
    assert not any(str(tmp_path) in word for word in words)


def test_midi_can_be_downloaded(tmp_path, episode):
    path = tmp_path / "a.html"
    midi = {"midi": b"MThd\0", "goal_midi": b"MThd\1"}
    page = performance_page(episode, {}, {}, SILENCE, **midi)
    write_page(path, page)
    links = {a["download"]: a["href"] for tag, a in Page(path).elements if tag == "a"}
    for name, expected in ("played.mid", b"MThd\0"), ("wanted.mid", b"MThd\1"):
        kind, content = links[name].split(";base64,")
        assert (kind, base64.b64decode(content)) == ("data:audio/midi", expected)


TEXT = [
    *(("ink", ground) for ground in ("page", "card", "row", "line")),
    *(("soft", ground) for ground in ("page", "card", "row")),
    ("accent", "card"),
    ("card", "accent"),
    *((name, "glass") for name in ("ink", "soft", "hit-text", "wrong-text", "missed-text")),
]
SIGNS = [*((verdict, "card") for verdict in ("hit", "wrong", "missed")), ("edge", "card")]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_contrast_enough(scheme):
    """WCAG 2.1 AA: 4.5 for text (1.4.3), 3 for what else one has to see (1.4.11)."""
    light, dark = (
        dict(re.findall(r"--([a-z-]+): (#[0-9a-f]{6});", part))
        for part in asset("page.css").split("@media (prefers-color-scheme: dark)")
    )
    glass = re.findall(r"--glass: rgb\((\d+) (\d+) (\d+) / (\d+)%\)", asset("page.css"))
    colours, behind = (light, 0) if scheme == "light" else (dark, 255)
    *rgb, opacity = map(int, glass[scheme == "dark"])
    over_the_worst = [round(opacity / 100 * c + (1 - opacity / 100) * behind) for c in rgb]
    colours["glass"] = "#" + bytes(over_the_worst).hex()

    def luminance(name):
        rgb = np.array([int(colours[name][i : i + 2], 16) / 255 for i in (1, 3, 5)])
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    for pairs, enough in ((TEXT, 4.5), (SIGNS, 3.0)):
        for pair in pairs:
            low, high = sorted(luminance(name) for name in pair)
            assert (high + 0.05) / (low + 0.05) >= enough, (scheme, pair)


def test_sheet_music_that_takes_too_long_is_left_out_and_told(monkeypatch):
    page = "cadenza.report.performance_page"
    monkeypatch.setattr(f"{page}._PATIENCE", 0.0)
    monkeypatch.setattr(f"{page}.engraving_within", engraving_within)
    written = Score((Note(0.0, 1.0, 60),))
    page = "".join(performance_page(make_episode(), {}, {}, SILENCE, written=written))
    assert "no sheet music here: engraving took over 0 s" in page
