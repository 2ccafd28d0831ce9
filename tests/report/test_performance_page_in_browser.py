import base64
import io
import json
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest
from made_up_episode import DT, STEPS, make_episode

from cadenza.cameras import VIEWS
from cadenza.episode import Episode
from cadenza.fingers import Finger
from cadenza.music.performance import performed_score
from cadenza.music.score import Note, Score
from cadenza.report.html_pages import write_page
from cadenza.report.performance_page import performance_page
from cadenza.report.sound import encode_opus, synthesize
from cadenza.scene.config import SceneConfig
from cadenza.scene.drawing import drawing
from cadenza.scene.scene import build_scene
from headless import Browser, needs_chromium

pytestmark = needs_chromium
DATA = Path(__file__).parents[1] / "data"


@pytest.fixture
def write(tmp_path):
    def written(episode, **more):
        path = tmp_path / "page.html"
        played = episode["key_activation"], episode["sustain_activation"]
        audio = synthesize(performed_score(*played, episode.dt))
        settings = {"agent": "none", "seed": 0}
        page = performance_page(episode, {"f1": float("nan")}, settings, audio, **more)
        write_page(path, page)
        return path

    return written


SHOW_DETAILS = "document.querySelector('.figures').open = true"


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
        abs(browser.evaluate("cadenza.time - document.getElementById('sound').currentTime")) < 0.6
    )
    browser.wait("!cadenza.playing")
    assert browser.evaluate("cadenza.time") == pytest.approx(STEPS * DT)
    assert browser.problems() == []


@pytest.mark.slow
def test_seeking_moves_the_hands_the_cursor_and_the_sound(browser, write, episode):
    browser.open(write(episode))
    browser.evaluate(SHOW_DETAILS)
    pictures = []
    for time in (0.2, 1.0):
        browser.evaluate(f"cadenza.seek({time})")
        pictures.append(
            [browser.picture(part).astype(int) for part in ("#view", "#roll", "#rewards")]
        )
        assert browser.evaluate("document.getElementById('sound').currentTime") == pytest.approx(
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


def press(browser, key, code=None, text=""):
    browser.call("Input.dispatchKeyEvent", type="keyDown", key=key, code=code or key, text=text)
    browser.call("Input.dispatchKeyEvent", type="keyUp", key=key, code=code or key)
    browser.settle()


@pytest.mark.slow
def test_a_button_over_the_picture_begins_and_then_is_gone(browser, write):
    browser.open(write(make_episode()))
    first = "document.getElementById('first')"
    assert browser.evaluate(f"{first}.textContent") == "▶ Play"
    browser.evaluate(f"{first}.click()")
    browser.wait("cadenza.playing")
    assert not browser.evaluate(f"{first}.checkVisibility()")


@pytest.mark.slow
def test_every_key_does_what_the_page_says(browser, write):
    browser.open(write(make_episode(steps=400)))
    end = 400 * DT
    browser.evaluate("cadenza.seek(8)")
    for key, time in (("l", 13), ("j", 8), ("ArrowRight", 8.5), ("End", end), ("Home", 0)):
        press(browser, key)
        assert browser.evaluate("cadenza.time") == pytest.approx(time), key
    press(browser, "m")
    assert browser.evaluate("document.getElementById('sound').muted")
    press(browser, "M")
    assert not browser.evaluate("document.getElementById('sound').muted")
    press(browser, "k")
    browser.wait("cadenza.playing")
    press(browser, "k")
    browser.wait("!cadenza.playing")


@pytest.mark.slow
def test_a_loop_begins_again(browser, write, episode):
    browser.open(write(episode))
    browser.evaluate("document.getElementById('loop').click()")
    browser.evaluate("(cadenza.seek(cadenza.duration - 0.3), cadenza.play())")
    browser.wait("cadenza.time < 0.9 && cadenza.playing", 10)


MISSES = [
    {"time": 0.2, "note": "C4", "finger": 2, "what": "never sounded", "cause": "too fast"},
    {"time": 1.5, "note": "E4", "finger": -1, "what": "100 ms late", "cause": "no finger"},
]
for miss in MISSES:
    miss["reason"] = f"{miss['cause']}: told by the planner"


def fate(time, pitch, played, part="harmony"):
    return {"start": time, "end": time + 0.5, "pitch": pitch, "played": played, "part": part}


@pytest.mark.slow
def test_fingers_are_numbered_in_the_roll_and_on_falling_notes(browser, write, episode):
    goal = np.zeros_like(episode["goal_keys"])
    goal[10:30, [39, 43]] = True
    episode.arrays["goal_keys"] = goal
    notes = (Note(0.5, 1.5, 60, finger=Finger(1, 0)), Note(0.5, 1.5, 64, finger=Finger(0, 4)))
    browser.open(write(episode, written=Score(notes)))
    assert browser.labels()[2][-2:] == ["1", "5"]
    browser.evaluate("document.getElementById('falling').click()")
    browser.settle()
    red, green, blue = np.moveaxis(browser.picture("#view").astype(int), 2, 0)
    assert ((blue > red + 40) & (blue > 200)).sum() > 50  # the right hand's
    assert ((red > green + 40) & (blue > green + 20) & (red > 200)).sum() > 50  # the left hand's
    assert browser.problems() == []


@pytest.mark.slow
def test_a_miss_seeks_to_shortly_before_it(browser, write, episode):
    browser.open(write(episode, misses=MISSES))
    browser.evaluate("document.querySelectorAll('#misses td:last-child')[1].click()")
    assert browser.evaluate("cadenza.time") == pytest.approx(0.8)
    browser.evaluate("document.querySelector('#misses button').focus()")
    press(browser, "Enter", text="\r")
    assert browser.evaluate("cadenza.time") == 0
    heads = "[...document.querySelectorAll('#misses th')].map(head => head.textContent)"
    assert browser.evaluate(heads) == ["Time", "Note", "Finger", "What", "Why"]


@pytest.mark.slow
def test_misses_of_the_same_reason_are_one_row_that_opens(browser, write, episode):
    far = {"note": "C4", "finger": -1, "what": "never sounded", "cause": "no finger"}
    several = [far | {"time": 0.1 * i, "reason": "too far from E4"} for i in range(9)]
    browser.open(write(episode, misses=[*MISSES, *several]))
    rows = "[...document.querySelectorAll('#misses tbody tr')].map((row) => row.innerText)"
    first, *others = browser.evaluate(rows)
    assert first == "9 notes too far from E4"
    assert len(others) == len(MISSES)
    browser.evaluate("document.querySelector('#misses button').focus()")
    press(browser, "Enter", text="\r")
    assert len(browser.evaluate(rows)) == 1 + 9 + len(MISSES)
    assert browser.evaluate("document.activeElement.getAttribute('aria-expanded')") == "true"
    press(browser, "Enter", text="\r")
    assert len(browser.evaluate(rows)) == 1 + len(MISSES)


@pytest.mark.slow
def test_what_an_arrangement_did_with_notes_is_shown_and_said(browser, write, episode):
    fates = [fate(0.5, 60, 60), fate(0.5, 64, None), fate(1, 48, 72, "bass")]
    fates += [fate(1.2, 67, 67) | {"again": True}]
    browser.open(write(episode, arrangement=fates))
    rows = "[...document.querySelectorAll('#changes tbody tr')].map((row) => row.innerText)"
    assert browser.evaluate(rows) == [
        "0.50 s\tE4\tharmony\tleft out",
        "1.00 s\tC3\tbass\tmoved up two octaves to C5",
        "1.20 s\tG4\tharmony\tstruck again",
    ]
    assert browser.evaluate("""document.querySelector('#roll canvas').ariaLabel""").endswith(
        "by the arrangement, 1 left out, 1 moved, 1 struck again"
    )

    def pointed_at(time, pitch):
        """What the roll says beside the pointer over a note."""
        return browser.evaluate(f"""(() => {{
            const roll = document.getElementById("roll"), box = roll.getBoundingClientRect();
            const names = written.get(roll.querySelector("canvas"));
            const [, , top, , bottom] = names.find(([text]) => text === "C4");
            const clientX = box.left + 44 + (box.width - 44) * {time} / cadenza.duration;
            const clientY = box.top + (top + bottom) / 2 - 15 * {pitch - 60};
            roll.dispatchEvent(new PointerEvent("pointermove", {{ clientX, clientY }}));
            const tip = roll.querySelector(".tip");
            return tip.hidden ? "" : tip.textContent;
        }})()""")

    assert pointed_at(0.7, 64) == "E4 of the harmony: left out"
    assert pointed_at(1.1, 72) == "C3 of the bass: moved up two octaves to C5"
    assert pointed_at(0.7, 60) == ""  # as written


@pytest.mark.slow
def test_the_goal_is_heard_from_where_the_performance_was(browser, write, episode):
    silence = encode_opus(np.zeros((0, 2), np.int16), seconds=STEPS * DT)
    browser.open(write(episode, goal_sound=silence))
    browser.evaluate("(cadenza.seek(0.4), cadenza.play())")
    browser.evaluate("document.querySelector('[data-sound=goal]').click()")
    browser.wait("!document.getElementById('goal').paused")
    assert browser.evaluate("document.getElementById('sound').paused")
    assert browser.evaluate("cadenza.time") >= 0.4
    browser.wait("!cadenza.playing")
    assert browser.evaluate("cadenza.time") == pytest.approx(STEPS * DT, abs=DT)


@pytest.mark.slow
def test_software_draws_flat_until_one_asks_for_3d(browser, write, episode):
    """As Chromium without a graphics card draws WebGL."""
    browser.open(write(episode))
    assert browser.evaluate("cadenza.stage.flat")
    assert "Flat view" in browser.evaluate("document.getElementById('flat-note').textContent")
    flat = browser.picture("#view").astype(int)
    browser.evaluate("document.getElementById('solid').click()")
    assert not browser.evaluate("cadenza.stage.flat")
    assert browser.evaluate("document.getElementById('flat-note').hidden")
    solid = browser.picture("#view").astype(int)
    assert (np.abs(flat - solid).max(axis=2) > 20).mean() > 0.05  # light and shadows
    browser.evaluate("document.getElementById('solid').click()")
    browser.settle()
    again = browser.picture("#view").astype(int)[60:-60]  # but for the buttons
    assert np.abs(again - flat[60:-60]).max() < 8
    assert browser.problems() == []


@pytest.mark.slow
def test_3d_that_turns_out_slow_gives_way_to_the_flat_view(browser, write):
    path = write(make_episode(steps=200))
    page = path.read_text("utf-8")
    assert "swiftshader|" in page
    path.write_text(page.replace("swiftshader|", ""), "utf-8")  # not known for software
    browser.open(path)
    assert not browser.evaluate("cadenza.stage.flat")
    browser.evaluate(
        "cadenza.stage.draw = () => { const end = performance.now() + 80;"
        "while (performance.now() < end); }"
    )
    browser.evaluate("cadenza.play()")
    browser.wait("cadenza.stage.flat")
    assert "slow" in browser.evaluate("document.getElementById('flat-note').textContent")


@pytest.mark.slow
def test_notes_fall_onto_their_keys_and_take_the_colour_of_the_verdict(browser, write):
    browser.open(write(make_episode(hands=0)))
    browser.evaluate(
        "document.querySelectorAll('#stage p, #first, .looks').forEach(e => { e.hidden = true; })"
    )

    def stretches(time):
        """Rows of the picture in which there is something green, as (first, last) of stretches."""
        browser.evaluate(f"cadenza.seek({time})")
        picture = browser.picture("#view").astype(int)
        rows = np.flatnonzero((picture[..., 1] > picture[..., 0] + 60).any(axis=1))
        return [
            (part[0], part[-1]) for part in np.split(rows, np.flatnonzero(np.diff(rows) > 3) + 1)
        ]

    assert len(stretches(0.9)) == 1  # the key that is hit
    browser.evaluate("document.getElementById('falling').click()")
    past, key = stretches(0.9)
    assert past[1] < key[0]
    assert past[1] - past[0] < key[1] - key[0]
    browser.evaluate("document.getElementById('falling').click()")
    assert len(stretches(0.9)) == 1


SIZES = {"laptop": (1280, 720), "desktop": (1920, 1080), "phone": (390, 844)}


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
def test_everything_fits_the_window(tmp_path, write, episode, size):
    width, height = SIZES[size]
    phone = size == "phone"
    silence = encode_opus(np.zeros((0, 2), np.int16), seconds=STEPS * DT)
    midi = {"midi": b"MThd", "goal_midi": b"MThd"}
    path = write(episode, misses=MISSES, goal_sound=silence, **midi)
    browser = Browser(tmp_path / "profile")
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        width=width,
        height=height,
        deviceScaleFactor=1,
        mobile=phone,
    )
    browser.call("Emulation.setTouchEmulationEnabled", enabled=phone)
    browser.open(path)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    box = "document.getElementById('play').getBoundingClientRect()"
    assert browser.evaluate(f"{box}.bottom") <= height
    small = """(() => [...document.querySelectorAll('button, a, select, input, summary')]
        .filter(e => e.checkVisibility()).map(e => [e.getBoundingClientRect(), e.outerHTML])
        .filter(([box]) => box.width < 44 || box.height < 44).map(([, html]) => html))()"""
    if phone:
        assert browser.evaluate(small) == []
    overlaps = """(() => {
        const shown = [...document.querySelectorAll('button, a, select, input, #stage p')]
            .filter(e => e.checkVisibility()).map(e => [e, e.getBoundingClientRect()]);
        return shown.flatMap(([a, p], i) => shown.slice(i + 1).filter(([b, q]) => a !== b
            && p.left < q.right - 1 && q.left < p.right - 1
            && p.top < q.bottom - 1 && q.top < p.bottom - 1)
            .map(([b]) => a.outerHTML + b.outerHTML));
    })()"""
    assert browser.evaluate(overlaps) == []
    browser.close()


@pytest.mark.slow
def test_a_finger_shifts_the_roll_and_a_tap_seeks(browser, write):
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True)
    browser.open(write(make_episode(steps=2000)))
    left, top, width = browser.evaluate(
        "(roll => { roll.scrollIntoView(); const box = roll.getBoundingClientRect();"
        "return [box.left, box.top, box.width]; })(document.getElementById('roll'))"
    )

    def touch(kind, *at):
        points = [{"x": at[0], "y": at[1]}] if at else []
        browser.call("Input.dispatchTouchEvent", type=kind, touchPoints=points)

    before = browser.picture("#roll").astype(int)
    touch("touchStart", left + 0.8 * width, top + 50)
    for share in (0.7, 0.5, 0.3):
        touch("touchMove", left + share * width, top + 50)
    touch("touchEnd")
    browser.settle()
    assert browser.evaluate("cadenza.time") == 0
    assert (np.abs(browser.picture("#roll").astype(int) - before) > 40).any()
    touch("touchStart", left + 44 + 0.5 * (width - 44), top + 50)
    touch("touchEnd")
    browser.settle()
    browser.call("Emulation.setTouchEmulationEnabled", enabled=False)
    window = min(24, (width - 44) / 34)
    shifted = 0.5 * width / (width - 44) * window
    assert browser.evaluate("cadenza.time") == pytest.approx(shifted + 0.5 * window, abs=0.3)


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
def test_what_reaches_behind_the_eye_leaves_the_flat_view_whole(tmp_path, write):
    """An arm on the player's side does, in the player's view."""
    browser = Browser(tmp_path / "profile", "--disable-3d-apis")
    episode = make_episode()
    browser.open(write(episode))
    before = browser.picture("#view").astype(int)
    for kind in ("capsule", "cylinder", "box", "sphere"):
        long = {"body": 0, "type": kind, "size": [0.1, 2.0, 0.1], "pos": [2.0, 0, 1.5]}
        along_x = {"quat": [0.7071068, 0, 0.7071068, 0], "rgba": [1, 0, 0, 1], "finger": None}
        episode.scene["geoms"].append(long | along_x)
    browser.open(write(episode))
    assert browser.problems() == []
    assert np.abs(browser.picture("#view").astype(int) - before).max() < 8
    browser.close()


@pytest.mark.slow
def test_keys_light_up_where_they_are(browser, write):
    browser.open(write(make_episode(hands=0)))
    browser.evaluate("document.querySelector('[data-view=top]').click()")
    browser.evaluate(
        "document.querySelectorAll('#stage p, #first, .looks').forEach(e => { e.hidden = true; })"
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
    assert 0.1 < hit < missed < wrong < 0.9
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
    browser.evaluate(SHOW_DETAILS)
    browser.settle()
    rows = browser.evaluate("[...document.querySelectorAll('.term')].map(row => row.textContent)")
    assert "energy mean 0.000at the cursor 0.000" in rows
    assert not any("-0.000" in row for row in rows)
    assert browser.labels()[-3:] == [["0", "2"], ["−1", "1"], ["−1e−4", "0"]]
    assert browser.colliding_labels("#rewards canvas") == []
    browser.evaluate("cadenza.seek(0)")
    hide = "document.querySelectorAll('.cursor').forEach(e => {{ e.style.visibility = '{}' }})"
    changes = {}
    for part in (".term", ".drawing", "#roll"):
        seen = []
        for visibility in ("visible", "hidden"):
            browser.evaluate(hide.format(visibility))
            seen.append(browser.picture(part).astype(int))
        changes[part] = np.abs(seen[0] - seen[1]).max(axis=(1, 2)) > 40  # rows of the picture
    assert not changes[".term"][:-1].any()  # its edge shows the chart
    assert changes[".drawing"].all()  # in charts there is a cursor, and in the roll itself
    assert changes["#roll"][:-30].any()
    assert not changes["#roll"][-20:].any()


@pytest.mark.slow
def test_on_a_narrow_screen_settings_break_at_separators(browser, tmp_path, episode):
    path, value = tmp_path / "page.html", "runs/a_rather_long_name/of_a_folder/with_an_episode"
    settings = {"agent.configuration.checkpoint_path": value}
    write_page(path, performance_page(episode, {}, settings, np.zeros((0, 2), np.int16)))
    size = {"height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", width=320, **size)
    browser.open(path)
    browser.evaluate(SHOW_DETAILS)
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


def recorded_scale(apart: float = 0.0) -> Episode:
    """Each hand is moved so far away from the other [m]."""
    scene = build_scene(SceneConfig(reduced_action_space=True))
    recorded = np.load(DATA / "episode_d.npz", allow_pickle=False)
    steps = len(recorded["action"])
    expected = ("action", "hand_qpos", "key_qpos", "key_activation", "sustain_activation")
    arrays = {name: recorded[name] for name in (*expected, "reward_total")}
    arrays |= {"goal_keys": recorded["key_activation"], "goal_sustain": np.zeros(steps, bool)}
    arrays["hand_qpos"][:, scene.slide_joints] += apart, -apart
    return Episode("scale", 0.05, arrays, drawing(scene))


@pytest.mark.slow
def test_a_recorded_performance_of_the_real_hands_is_drawn(browser, write):
    with_hands = recorded_scale()
    shells = [shell | {"balls": [[0, 0, 0, 1e-5]]} for shell in with_hands.scene["shells"]]
    parts = with_hands.scene | {"shells": shells}
    pictures = []
    for episode in (with_hands, replace(with_hands, scene=parts)):
        browser.open(write(episode))
        browser.evaluate("cadenza.seek(3.2)")
        pictures.append(browser.picture("#view").astype(int))
        assert browser.problems() == []
    changed = np.abs(pictures[0] - pictures[1]).max(axis=2) > 40
    width = changed.shape[1]
    for half in (changed[:, : width // 2], changed[:, width // 2 :]):
        assert 0.01 < half.mean() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("encodes", [True, False], ids=["WebCodecs", "MediaRecorder"])
def test_the_button_makes_a_film_with_sound(tmp_path, write, encodes):
    browser = Browser(tmp_path / "profile", "--enable-unsafe-swiftshader")
    if not encodes:
        source = "delete globalThis.VideoEncoder"
        browser.call("Page.addScriptToEvaluateOnNewDocument", source=source)
    browser.open(write(make_episode(steps=20)))
    browser.evaluate("""(() => {
        const { createObjectURL } = URL;
        URL.createObjectURL = (file) => createObjectURL(window.film = file);
        document.getElementById("film").click();
        document.getElementById("film-size").options[0].value = "128 72";
        document.getElementById("film-make").click();
    })()""")
    browser.wait("/^(Saved|No film)/.test(document.getElementById('film-status').textContent)", 90)
    content = browser.evaluate("""film.arrayBuffer().then((bytes) =>
        btoa(String.fromCharCode(...new Uint8Array(bytes))))""")
    assert browser.problems() == []
    browser.close()
    with av.open(io.BytesIO(base64.b64decode(content))) as film:
        pictures = [(frame.time, frame.width, frame.height) for frame in film.decode(video=0)]
    with av.open(io.BytesIO(base64.b64decode(content))) as film:
        sound = np.concatenate([frame.to_ndarray() for frame in film.decode(audio=0)], axis=1)
    assert all(size == [128, 72] for _, *size in pictures)
    assert 0.5 < pictures[-1][0] < 2.5  # of 1 s, of which a slow machine records fewer pictures
    assert np.abs(sound).max() > 0.01


# The colours of a picture as it is drawn flat; nothing is where the sky shows.
PICTURE = """(([view, width, height, time, falling]) => {
    const { stage } = cadenza, copy = document.createElement("canvas");
    Object.assign(copy, { width, height });
    stage.setFlat(true);
    stage.showNotes(falling);
    stage.fit(width, height);
    stage.move(time);
    stage.look(view);
    stage.draw();
    const context = copy.getContext("2d");
    context.drawImage(stage.picture, 0, 0, width, height);
    return [...context.getImageData(0, 0, width, height).data];
})"""


def drawn(browser, view, shape, time, falling=True):
    pixels = browser.evaluate(f"{PICTURE}({json.dumps([view, *shape, time, falling])})")
    return np.array(pixels, np.uint8).reshape(*shape[::-1], 4).astype(int)


def margins(shown):
    """The share of a picture (H, W) at its left, right, upper and lower edge that is not shown."""
    (ys, xs), (height, width) = np.nonzero(shown), shown.shape
    return (
        xs.min() / width,
        1 - (xs.max() + 1) / width,
        ys.min() / height,
        1 - (ys.max() + 1) / height,
    )


@pytest.mark.slow
@pytest.mark.parametrize("falling", [False, True])
@pytest.mark.parametrize("apart", [-0.05, 0.1, 0.3])
def test_piano_or_hands_fill_a_picture_of_any_shape_and_none_is_cut(browser, write, falling, apart):
    played = recorded_scale(apart)
    left_along = build_scene(SceneConfig(reduced_action_space=True)).slide_joints[1]
    played["hand_qpos"][98:, left_along] -= 0.1  # which leaps just before 5 s
    forearms = {
        i for i, name in enumerate(played.scene["bodies"]) if name.endswith(("forearm", "wrist"))
    }
    for part in [*played.scene["geoms"], *played.scene["shells"]]:
        if part["body"] >= 0 and part["body"] not in forearms:
            part["rgba"] = [1, 0, 1, 1]
    browser.open(write(played))
    shapes = (320, 180), (180, 320), (240, 180), (240, 240)
    for view in VIEWS:
        wide = [(400, 104)] * (not falling and view != "side")
        for shape in (*shapes, *wide):
            for time in (0.2, 5):
                picture = drawn(browser, view, shape, time, falling)
                empty = margins(picture[..., 3] > 200)
                assert max(empty) <= 0.1, (view, shape, time, empty)
                hands = picture[..., [0, 2]].min(axis=2) > picture[..., 1] + 70
                assert hands.any()
                assert min(margins(hands)) > 0, (view, shape, time)


@pytest.mark.slow
def test_forearms_are_hardly_cut_in_tall_pictures(browser, write):
    looks = [(view, time) for view in VIEWS if view not in ("close", "side") for time in (3, 5)]
    with_hands = recorded_scale(-0.05)
    shells = [shell | {"balls": [[0, 0, 0, 1e-5]]} for shell in with_hands.scene["shells"]]
    pictures = []
    for scene in (with_hands.scene, with_hands.scene | {"shells": shells}):
        browser.open(write(replace(with_hands, scene=scene)))
        pictures.append([drawn(browser, view, (180, 320), time) for view, time in looks])
    for look, with_shells, without in zip(looks, *pictures, strict=True):
        arms = np.abs(with_shells - without).max(axis=2) > 40
        cut = max(arms[:, 0].mean(), arms[:, -1].mean(), arms[0].mean(), arms[-1].mean())
        assert cut < 0.1, (look, cut)
