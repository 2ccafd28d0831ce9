from pathlib import Path

import numpy as np
import pytest
from conftest import DT, STEPS, make_episode
from headless import Browser, needs_chromium

from cadenza.episode import Episode
from cadenza.model.config import SceneConfig
from cadenza.model.drawing import drawing
from cadenza.model.scene import build_scene
from cadenza.music.performance import performed_score
from cadenza.report.page import write_report
from cadenza.report.sound import synthesize

pytestmark = needs_chromium
DATA = Path(__file__).parents[1] / "data"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


@pytest.fixture
def write(tmp_path):
    def written(episode):
        path = tmp_path / "page.html"
        played = episode["key_activation"], episode["sustain_activation"]
        audio = synthesize(performed_score(*played, episode.dt))
        write_report(path, episode, {"f1": float("nan")}, {"agent": "none", "seed": 0}, audio)
        return path

    return written


def test_the_page_opens_plays_and_shows_two_hands_over_a_keyboard(browser, write, episode):
    browser.open(write(episode))
    assert browser.problems() == []
    assert [
        url for url in browser.loaded() if not url.startswith(("file:", "blob:", "data:"))
    ] == []
    assert browser.evaluate("cadenza.duration") == pytest.approx(STEPS * DT)

    browser.evaluate("cadenza.seek(0.5)")
    with_hands = browser.picture("#view").astype(int)
    width = with_hands.shape[1]
    colour = with_hands.max(axis=2) - with_hands.min(axis=2)
    fingertips = colour > 90
    assert fingertips[:, : width // 2].sum() > 100
    assert fingertips[:, width // 2 :].sum() > 100
    bright = with_hands.min(axis=2) > 150
    changes = np.abs(np.diff(bright.astype(int), axis=1)).sum(axis=1)
    assert changes.max() > 50  # some line of the picture crosses white and black keys

    browser.evaluate("cadenza.play()")
    browser.wait("cadenza.time > 0.9")
    assert (
        abs(browser.evaluate("cadenza.time - document.getElementById('audio').currentTime")) < 0.6
    )
    browser.wait("!cadenza.playing")
    assert browser.evaluate("cadenza.time") == pytest.approx(STEPS * DT)
    assert browser.problems() == []


@pytest.mark.slow
def test_seeking_moves_the_hands_the_cursor_and_the_sound(browser, write, episode):
    browser.open(write(episode))
    pictures = []
    for time in (0.2, 1.0):
        browser.evaluate(f"cadenza.seek({time})")
        pictures.append(
            [browser.picture(part).astype(int) for part in ("#view", "#roll", "#rewards")]
        )
        assert browser.evaluate("document.getElementById('audio').currentTime") == pytest.approx(
            time
        )
    for before, after in zip(*pictures, strict=True):
        assert (np.abs(after - before).max(axis=2) > 40).sum() > 100


@pytest.mark.slow
def test_clicks_and_keys_seek_and_play(browser, write, episode):
    browser.open(write(episode))
    box = browser.evaluate(
        "(({left, top, width}) => [left, top, width])"
        "(document.getElementById('roll').getBoundingClientRect())"
    )
    at = {
        "x": box[0] + 44 + 0.5 * (box[2] - 44),
        "y": box[1] + 30,
        "button": "left",
        "clickCount": 1,
    }
    browser.call("Input.dispatchMouseEvent", type="mousePressed", **at)
    browser.call("Input.dispatchMouseEvent", type="mouseReleased", **at)
    browser.settle()
    assert browser.evaluate("cadenza.time") == pytest.approx(STEPS * DT / 2, abs=0.02)
    browser.call("Input.dispatchKeyEvent", type="keyDown", key="ArrowLeft", code="ArrowLeft")
    browser.settle()
    assert browser.evaluate("cadenza.time") == pytest.approx(STEPS * DT / 2 - 0.5, abs=0.02)
    browser.call("Input.dispatchKeyEvent", type="keyDown", key=" ", code="Space", text=" ")
    browser.wait("cadenza.playing")


@pytest.mark.slow
@pytest.mark.parametrize(
    "episode",
    [
        make_episode(steps=1),
        make_episode(hands=1),
        make_episode(hands=0),
        Episode("no drawing", DT, make_episode().arrays, {}),
        make_episode(song="</script><script>cadenza.error = 'injected'</script>"),
        make_episode(steps=6000),
    ],
    ids=["one step", "one hand", "no hands", "no drawing", "markup in the title", "five minutes"],
)
def test_unusual_episodes_open(browser, write, episode):
    browser.open(write(episode))
    assert browser.evaluate("document.querySelector('h1').textContent") == episode.song
    browser.evaluate(f"cadenza.seek({0.7 * episode.num_steps * DT})")
    browser.settle()
    assert browser.evaluate("cadenza.time") == pytest.approx(0.7 * episode.num_steps * DT)
    assert browser.evaluate("cadenza.error") is None
    assert browser.problems() == []


@pytest.mark.slow
def test_without_webgl_the_hands_are_drawn_flat(tmp_path, write):
    browser = Browser(tmp_path / "profile", "--disable-3d-apis")
    pictures = []
    for hands in (2, 0):
        browser.open(write(make_episode(hands=hands)))
        browser.evaluate("cadenza.seek(0.5)")
        pictures.append(browser.picture("#view").astype(int))
    browser.close()
    changed = np.abs(pictures[0] - pictures[1]).max(axis=2) > 40
    width = changed.shape[1]
    assert changed[:, : width // 2].sum() > 2000
    assert changed[:, width // 2 :].sum() > 2000


@pytest.mark.slow
def test_keys_light_up_where_they_are(browser, write):
    browser.open(write(make_episode(hands=0)))
    browser.evaluate("document.querySelector('[data-view=top]').click()")
    browser.evaluate(
        "document.querySelectorAll('#stage > :not(canvas)').forEach(e => { e.hidden = true; })"
    )

    def place(time, colour, other):
        """Where along the picture's width (0..1) `colour` outshines `other`."""
        browser.evaluate(f"cadenza.seek({time})")
        picture = browser.picture("#view").astype(int)
        lit = np.argwhere(picture[..., colour] > picture[..., other] + 70)
        assert len(lit) > 300
        return lit[:, 1].mean() / picture.shape[1]

    red, green, blue = 0, 1, 2
    hit = place(0.5, green, red)  # key 39
    missed, wrong = place(1.3, blue, green), place(1.3, red, green)  # keys 43 and 50
    assert 0.4 < hit < missed < wrong < 0.65
    # Whole tones of the white row: 39 is its 23rd key, 43 its 25th, 50 its 29th.
    assert (missed - hit) / (wrong - missed) == pytest.approx(2 / 4, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("flags", [[], ["--disable-3d-apis"]], ids=["3D", "flat"])
def test_fingertips_have_the_colours_of_the_scene(tmp_path, write, flags):
    browser = Browser(tmp_path / "profile", *flags)
    episode = make_episode()
    fingertips = [geom for geom in episode.scene["geoms"] if geom["finger"] is not None]
    for channel in range(3):
        colour = [0.1] * 3
        colour[channel] = 0.9
        for geom in fingertips:
            geom["rgba"] = [*colour, 1]
        browser.open(write(episode))
        browser.evaluate("cadenza.seek(0)")  # no key is pressed yet, only one missing
        browser.evaluate("document.querySelector('#stage .legend').hidden = true")
        others = [c for c in range(3) if c != channel]
        picture = browser.picture("#view").astype(int)
        assert (picture[..., channel] > picture[..., others].max(axis=2) + 70).sum() > 500
    browser.close()


@pytest.mark.slow
def test_rewards_say_what_their_numbers_are_and_the_cursor_strikes_out_none(browser, write):
    episode = make_episode()
    episode.arrays["reward_energy"][:] = -1e-4
    browser.open(write(episode))
    rows = browser.evaluate("[...document.querySelectorAll('.term')].map(row => row.textContent)")
    assert "energy mean 0.000at the cursor 0.000" in rows
    assert not any("-0.000" in row for row in rows)
    browser.evaluate("cadenza.seek(0)")
    hide = "document.querySelectorAll('.cursor').forEach(e => {{ e.style.visibility = '{}' }})"
    for part in (".term", "#roll"):
        seen = []
        for visibility in ("visible", "hidden"):
            browser.evaluate(hide.format(visibility))
            seen.append(browser.picture(part).astype(int))
        changed = np.abs(seen[0] - seen[1]).max(axis=(1, 2)) > 40  # rows of the picture
        words = changed[-20:] if part == "#roll" else changed[:-1]  # its edge shows the chart
        assert not words.any()
    assert changed[:-30].any()  # over the roll itself there is a cursor


@pytest.mark.slow
def test_on_a_narrow_screen_settings_break_at_separators(browser, tmp_path, episode):
    path, value = tmp_path / "page.html", "runs/a_rather_long_name/of_a_folder/with_an_episode"
    settings = {"agent.configuration.checkpoint_path": value}
    write_report(path, episode, {}, settings, np.zeros((0, 2), np.float32))
    size = {"height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", width=320, **size)
    browser.open(path)
    lines = browser.evaluate("""(() => {
        const lines = new Map(), range = document.createRange();
        for (const node of document.querySelector('td').childNodes)
            for (let i = 0; i < (node.data ?? '').length; i++) {
                range.setStart(node, i);
                range.setEnd(node, i + 1);
                const { top } = range.getBoundingClientRect();
                lines.set(top, (lines.get(top) ?? '') + node.data[i]);
            }
        return [...lines.values()];
    })()""")
    browser.call("Emulation.setDeviceMetricsOverride", width=1000, **size | {"height": 1700})
    assert "".join(lines) == value
    assert len(lines) == 2
    assert lines[0][-1] in "/_"
    browser.settle()
    assert browser.evaluate("document.querySelector('tr').offsetHeight") < 2 * 21  # one line


@pytest.mark.slow
def test_a_recorded_performance_of_the_real_hands_is_drawn(browser, write):
    scene = build_scene(SceneConfig(reduced_action_space=True))
    recorded = np.load(DATA / "episode_d.npz", allow_pickle=False)
    steps = len(recorded["action"])
    wanted = ("action", "hand_qpos", "key_qpos", "key_activation", "sustain_activation")
    arrays = {name: recorded[name] for name in (*wanted, "reward_total")}
    arrays |= {"goal_keys": recorded["key_activation"], "goal_sustain": np.zeros(steps, bool)}
    with_hands = Episode("scale", 0.05, arrays, drawing(scene))
    parts = with_hands.scene | {"geoms": [g for g in with_hands.scene["geoms"] if g["body"] < 0]}
    pictures = []
    for episode in (with_hands, Episode("scale", 0.05, arrays, parts)):
        browser.open(write(episode))
        browser.evaluate("cadenza.seek(3.2)")
        pictures.append(browser.picture("#view").astype(int))
        assert browser.problems() == []
    changed = np.abs(pictures[0] - pictures[1]).max(axis=2) > 40
    width = changed.shape[1]
    for half in (changed[:, : width // 2], changed[:, width // 2 :]):
        assert 0.01 < half.mean() < 0.3
