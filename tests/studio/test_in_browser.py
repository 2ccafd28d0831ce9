"""The studio in a browser, with a server and players of its own."""

import base64
import io
import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

import mido
import numpy as np
import pytest

from cadenza.episode import load_episode
from cadenza.errors import CadenzaError
from cadenza.music.arrangement import Arrangement, load_song
from cadenza.music.formats.midi import write_midi
from cadenza.music.formats.reading import read_score
from cadenza.music.score import Note, Score
from headless import Browser, needs_chromium

pytest.importorskip("uvicorn", reason="needs cadenza[studio]")
pytestmark = [pytest.mark.slow, needs_chromium]


@contextmanager
def page_of(*command: str) -> Iterator[str]:
    """The address that a command prints, which ends with Ctrl-C."""
    line = [sys.executable, "-m", "cadenza", *command]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    try:
        yield process.stdout.readline().split()[-1]
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        process.stdout.close()


def studio(folder: Path) -> AbstractContextManager[str]:
    return page_of("studio", "--folder", str(folder), "--no-browser", "--jobs", "1")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("studio")


@pytest.fixture(scope="module")
def address(folder):
    with studio(folder) as address:
        yield address


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    browser = Browser(tmp_path_factory.mktemp("profile"))
    yield browser
    browser.close()


def wait(browser: Browser, condition: str) -> None:
    """Wait for long: players share the machine with other processes."""
    browser.wait(condition, 150)


def visit(browser: Browser, address: str) -> None:
    browser.events.clear()
    browser.call("Page.navigate", url="about:blank")
    browser.call("Page.navigate", url=address)
    wait(browser, "!!window.cadenza && cadenza.ready")
    assert browser.evaluate("cadenza.error") is None
    browser.evaluate("document.getElementById('agent').value = 'sight'")


def drop(browser: Browser, content: bytes, name: str) -> None:
    """Drops a file on the page."""
    data = base64.b64encode(content).decode()
    browser.evaluate(f"""(async () => {{
        const bytes = Uint8Array.from(atob("{data}"), (c) => c.charCodeAt(0));
        const dataTransfer = new DataTransfer();
        dataTransfer.items.add(new File([bytes], {json.dumps(name)}));
        document.body.dispatchEvent(new DragEvent("drop", {{ dataTransfer, bubbles: true }}));
    }})()""")


def song(path: Path, count: int = 6) -> bytes:
    write_midi(Score(tuple(Note(0.5 * i, 0.5 * i + 0.4, 67 + i % 3) for i in range(count))), path)
    return path.read_bytes()


def press(browser: Browser, within: str, name: str) -> None:
    """The first button of that name."""
    buttons = f"[...document.querySelectorAll('{within} button')]"
    browser.evaluate(f"{buttons}.find((button) => button.textContent === '{name}').click()")


def cancel(browser: Browser) -> None:
    """Cancels what is planned, where a fast machine is not through with it already."""
    browser.evaluate("document.getElementById('cancel').click()")
    wait(browser, "['cancelled', 'played', 'writing', 'kept'].includes(cadenza.state)")


@pytest.fixture(scope="module")
def kept(browser, address, tmp_path_factory):
    """A performance that is kept, and can be watched."""
    visit(browser, address)
    drop(browser, song(tmp_path_factory.mktemp("kept") / "kept.mid"), "kept.mid")
    wait(browser, "cadenza.state === 'kept' && document.getElementById('kept').children.length")


SCORES = "f1", "precision", "recall", "onsets"


def uncaught(browser: Browser) -> list[str]:
    """The problems in the console, but for answers of the server, which browsers list."""
    return [each for each in browser.problems() if '"source": "network"' not in each]


def text(browser: Browser, id: str) -> str:
    return browser.evaluate(f"document.getElementById('{id}').innerText")


def test_a_dropped_file_plays_to_its_end_and_is_kept(browser, address, folder, tmp_path):
    visit(browser, address)
    drop(browser, song(tmp_path / "a.mid"), "../My <b>song.mid")
    wait(browser, "cadenza.began")
    assert text(browser, "title") == "../My <b>song"
    assert browser.evaluate("cadenza.live.show(0), cadenza.live.scores") == [None] * 4  # in silence
    wait(browser, "cadenza.time > 1.2")
    wait(browser, "cadenza.finished")
    assert text(browser, "clock") == text(browser, "length")
    f1, precision, recall, onsets = browser.evaluate("cadenza.live.scores")
    # Sounds are struck when their keys are; a machine that is busy may be late now and then.
    late = sorted(abs(at - due) for due, _, at in browser.evaluate("cadenza.strikes"))
    assert late
    assert late[len(late) // 2] < 0.02
    wait(browser, "cadenza.state === 'kept' && document.getElementById('kept').children.length")
    id = browser.evaluate("location.hash").removeprefix("#job=")
    kept = folder / id
    metrics = json.loads((kept / "metrics.json").read_text())
    scores = {"f1": f1, "precision": precision, "recall": recall, "note_onset_f1": onsets}
    for name, shown in scores.items():
        assert shown == pytest.approx(metrics[name], abs=1e-9)
    assert metrics["f1"] > 0.5
    verdict = text(browser, "verdict")
    assert "in time (within 50 ms)" in verdict
    assert verdict in text(browser, "kept")
    assert text(browser, "doing") == verdict
    assert verdict in (kept / "report.html").read_text()
    assert "My <b>song" in text(browser, "kept")
    assert browser.problems() == []
    # The report opens, and cannot reach the studio.
    url = browser.evaluate("document.querySelector('#kept a').href")
    browser.call("Page.navigate", url=url)
    wait(browser, "!!window.cadenza && cadenza.ready")
    assert browser.evaluate("origin") == "null"
    assert browser.problems() == []


@pytest.mark.usefixtures("kept")
def test_what_is_shown_no_more_is_let_go(browser, address):
    """A page that is open for days shows many performances."""
    visit(browser, address)
    browser.call("Performance.enable")

    def counted() -> tuple[float, float]:
        press(browser, "#kept", "Watch")
        wait(browser, "cadenza.live && cadenza.time > 0.3")
        browser.settle()
        browser.call("HeapProfiler.collectGarbage")
        values = browser.call("Performance.getMetrics")["metrics"]
        metrics = {metric["name"]: metric["value"] for metric in values}
        return metrics["JSEventListeners"], metrics["Nodes"]

    listeners, nodes = counted()
    for _ in range(5):
        more = counted()
    assert more[0] <= listeners + 12  # those of one may wait to be collected
    assert more[1] <= nodes + 20
    assert browser.problems() == []


@pytest.mark.usefixtures("kept")
def test_one_can_go_back_and_forth(browser, address):
    visit(browser, address)
    press(browser, "#kept", "Watch")
    wait(browser, "cadenza.time > 0.5")
    length = browser.evaluate("cadenza.live.steps * cadenza.live.dt")
    scrub = "((scrub) => { scrub.value = 2; scrub.dispatchEvent(new Event('input')); })"
    browser.evaluate(f"{scrub}(document.getElementById('scrub'))")
    browser.settle()
    assert 2 <= browser.evaluate("cadenza.time") < 3
    browser.evaluate("cadenza.seek(0)")
    for key in " ", "ArrowRight", "ArrowRight", "ArrowLeft":
        browser.call("Input.dispatchKeyEvent", type="keyDown", key=key)
    browser.settle()
    time = browser.evaluate("cadenza.time")
    assert 0.5 <= time < 1.5
    last = browser.evaluate("cadenza.live.states.findLastIndex((state) => state && state < 4)")
    assert last // 88 * 0.05 <= time + 0.05  # nothing later is shown as played
    browser.evaluate("cadenza.seek(99)")
    browser.settle()
    assert browser.evaluate("cadenza.time") == pytest.approx(length, abs=1e-6)
    browser.call("Input.dispatchKeyEvent", type="keyDown", key=" ")
    wait(browser, "cadenza.finished")
    browser.call("Input.dispatchKeyEvent", type="keyDown", key=" ")  # once more
    wait(browser, "!cadenza.finished && cadenza.time < 2")


@pytest.mark.usefixtures("kept")
def test_a_click_in_the_roll_goes_there(browser, address):
    visit(browser, address)
    press(browser, "#kept", "Watch")
    wait(browser, "cadenza.began")
    browser.evaluate("document.getElementById('roll').scrollIntoView()")
    browser.settle()
    left, top, width, height = browser.evaluate("""(() => {
        const { x, y, width, height } = document.getElementById("roll").getBoundingClientRect();
        return [x + 44, y, width - 44, height]; // the names of the keys are 44 px wide
    })()""")
    length = browser.evaluate("cadenza.live.steps * cadenza.live.dt")
    browser.call("Input.dispatchKeyEvent", type="keyDown", key=" ")
    for kind in "mousePressed", "mouseReleased":
        where = {"x": left + 0.5 * width, "y": top + 0.3 * height}
        browser.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **where)
    browser.settle()
    assert browser.evaluate("cadenza.time") == pytest.approx(0.5 * length, abs=0.1)
    assert browser.problems() == []


def test_the_score_follows_and_a_click_goes_to_its_notes(browser, address, tmp_path):
    visit(browser, address)
    drop(browser, song(tmp_path / "eight.mid", 8), "eight.mid")
    wait(browser, "document.querySelectorAll('#score .note').length === 8")
    wait(browser, "cadenza.finished")
    last = "[...document.querySelectorAll('#score .note')].at(-1)"
    browser.evaluate(f"{last}.dispatchEvent(new MouseEvent('click', {{ bubbles: true }}))")
    wait(browser, f"{last}.matches('.sounding')")
    assert browser.evaluate("document.querySelectorAll('#score .sounding').length") == 1
    browser.evaluate("cadenza.seek(0)")
    wait(browser, "!document.querySelector('#score .sounding')")
    numbers = "[...document.querySelectorAll('#score .fing')].map((text) => text.textContent)"
    assert set(browser.evaluate(numbers)) <= set("12345")
    assert len(browser.evaluate(numbers)) == 8
    # It is there again where the performance is opened later.
    wait(browser, "cadenza.state === 'kept'")
    browser.call("Page.reload")
    wait(browser, "!!window.cadenza && cadenza.ready")
    wait(browser, "document.querySelectorAll('#score .note').length === 8")
    assert uncaught(browser) == []


def test_what_is_chosen_behind_more_is_played(browser, address, folder, tmp_path):
    """One of two tracks, by Allegro hands, faster and higher; what is kept can be taken away."""
    visit(browser, address)
    file = mido.MidiFile(ticks_per_beat=480)
    for pitch in 40, 64:
        kinds = ["note_on", "note_off"] * 4
        file.tracks.append(mido.MidiTrack(mido.Message(k, note=pitch, time=240) for k in kinds))
    file.save(tmp_path / "two.mid")
    drop(browser, (tmp_path / "two.mid").read_bytes(), "two.mid")
    wait(browser, "!document.getElementById('tracks').hidden && cadenza.live")
    browser.evaluate("""(() => {
        const put = (id, value) => Object.assign(document.getElementById(id), { value });
        put("hand", "allegro"); put("tempo", "1.5"); put("transpose", "2"); put("seed", "5");
        document.querySelector("#tracks input").click();
        document.getElementById("start").click();
    })()""")
    wait(browser, "cadenza.state === 'kept' && cadenza.finished")
    how = "Allegro Hand, four fingers · +2 semitones · 1.5× · take 5"
    assert text(browser, "facts").endswith(how)
    id = browser.evaluate("location.hash").removeprefix("#job=")
    settings = json.loads((folder / id / "settings.json").read_text())
    assert (settings["scene"]["hand"], settings["seed"]) == ("allegro", 5)
    assert settings["task"]["stretch"] == pytest.approx(1 / 1.5)
    expected = load_episode(folder / id / "episode.npz")["goal_keys"].any(axis=0)
    assert list(np.flatnonzero(expected) + 21) == [66]
    wait(browser, "!!document.querySelector('#kept li:first-child a[download=\"two.mid\"]')")
    links = browser.evaluate("""(async () => {
        const links = [...document.querySelectorAll("#kept li:first-child a")];
        return await Promise.all(links.map(async (link) => {
            const answer = await fetch(link.href), begin = (await answer.text()).slice(0, 4);
            return [link.textContent, link.download, answer.status, begin];
        }));
    })()""")
    assert links == [
        ["Report", "", 200, "<!do"],
        ["Film", "", 200, "<!do"],
        ["MIDI", "two.mid", 200, "MThd"],
        ["Wanted MIDI", "two, as wanted.mid", 200, "MThd"],
    ]
    assert browser.problems() == []


@pytest.mark.usefixtures("kept")
def test_an_upload_can_be_deleted(browser, address, folder):
    visit(browser, address)
    browser.evaluate("window.confirm = () => true")
    before = len(list((folder / "uploads").iterdir()))
    shown = "document.getElementById('songs').innerText.split('×').length"
    uploads = browser.evaluate(shown)
    press(browser, "#songs", "×")
    wait(browser, f"{shown} === {uploads - 1}")
    assert len(list((folder / "uploads").iterdir())) == before - 2  # the file, and what it is
    press(browser, "#kept", "Watch")  # which was played of it
    wait(browser, "cadenza.began")
    assert browser.evaluate("cadenza.error") is None
    assert browser.evaluate("document.getElementById('start').disabled")
    assert browser.problems() == []


def test_a_link_to_a_deleted_upload_says_so(browser, address):
    visit(browser, address)
    browser.evaluate("location.hash = '#song=upload/gone&tempo=1'")
    wait(browser, "cadenza.error?.startsWith('This song is not here any more')")
    assert browser.evaluate("document.getElementById('start').disabled")
    visit(browser, address)


@pytest.mark.usefixtures("kept")
def test_a_song_after_a_whole_one_is_drawn_at_once(browser, address, tmp_path):
    """The flat view draws more often what is whole, and must not make up for that afterwards."""
    visit(browser, address)
    press(browser, "#kept", "Watch")
    wait(browser, "cadenza.finished")
    time.sleep(8)
    drop(browser, song(tmp_path / "g.mid", 60), "g.mid")
    wait(browser, "cadenza.state === 'playing' && cadenza.began")
    frames = browser.evaluate("""new Promise((done) => {
        let frames = 0;
        (function next() {
            frames++;
            if (cadenza.time > 0.3 || frames > 300) done(frames);
            else requestAnimationFrame(next);
        })();
    })""")
    assert frames < 60  # of which there are sixty a second at most
    cancel(browser)


def test_a_page_that_is_loaded_again_goes_on(browser, address, tmp_path):
    visit(browser, address)
    drop(browser, song(tmp_path / "b.mid", 12), "b.mid")
    wait(browser, "cadenza.time > 1.5")
    browser.call("Page.reload")
    time.sleep(0.2)
    wait(browser, "!!window.cadenza && cadenza.ready && cadenza.began")
    assert browser.evaluate("cadenza.time") > 1
    cancel(browser)


def test_cancel_ends_the_player_and_keeps_nothing(browser, address, folder, tmp_path):
    visit(browser, address)
    browser.evaluate("document.getElementById('agent').value = 'planner'")  # it takes its time
    for moment in "cadenza.live", "cadenza.time > 0.5":
        drop(browser, song(tmp_path / "c.mid", 300), "c.mid")
        wait(browser, f"cadenza.state !== 'cancelled' && {moment}")  # not of the one before
        cancel(browser)
        assert browser.evaluate("cadenza.state") == "cancelled"
        assert text(browser, "doing") == "Cancelled."
        browser.settle()
        stopped = browser.evaluate("cadenza.time")
        time.sleep(0.5)
        assert browser.evaluate("cadenza.time") == stopped
        assert text(browser, "doing") == "Cancelled."
    kept = [json.loads(path.read_text())["title"] for path in folder.glob("*/studio.json")]
    assert "c" not in kept
    assert not list(folder.glob(".*/episode.npz"))


def test_a_song_is_chosen_by_the_keyboard(browser, address):
    visit(browser, address)
    browser.evaluate("document.querySelector('[data-song=MaryHadALittleLamb]').focus()")
    enter = {"key": "Enter", "code": "Enter", "windowsVirtualKeyCode": 13, "text": "\r"}
    browser.call("Input.dispatchKeyEvent", type="keyDown", **enter)
    browser.call("Input.dispatchKeyEvent", type="keyUp", **enter)
    wait(browser, "cadenza.live")
    assert browser.evaluate("document.activeElement.dataset.song") == "MaryHadALittleLamb"
    pressed = "[...document.querySelectorAll('#songs [aria-pressed=true]')].map((b) => b.title)"
    assert browser.evaluate(pressed) == ["Mary Had a Little Lamb, traditional"]
    cancel(browser)


def test_of_songs_chosen_at_once_the_last_is_played(browser, address):
    visit(browser, address)
    browser.evaluate("""for (const song of ["OdeToJoy", "JingleBells", "FrereJacques"])
        document.querySelector(`[data-song=${song}]`).click()""")
    wait(browser, "cadenza.began && document.title.startsWith('Frère Jacques')")
    sent = [e["params"] for e in browser.events if e["method"] == "Network.requestWillBeSent"]
    asked = [each["request"] for each in sent if "/api/jobs" in each["request"]["url"]]
    methods = [request["method"] for request in asked]
    assert methods.count("POST") == methods.count("DELETE") + 1
    cancel(browser)
    assert browser.problems() == []


def test_what_is_being_prepared_goes_on_when_it_is_asked_for_again(browser, address):
    visit(browser, address)
    play = "document.querySelector('[data-song=OdeToJoy]').click()"
    browser.evaluate(f"{play}; {play}")  # before the server has answered
    wait(browser, "cadenza.state !== 'idle'")
    browser.evaluate(f"cadenza.live || {play}")
    wait(browser, "cadenza.began && document.title.startsWith('Ode to Joy')")
    sent = [e["params"] for e in browser.events if e["method"] == "Network.requestWillBeSent"]
    asked = [each["request"] for each in sent if "/api/jobs" in each["request"]["url"]]
    assert [request["method"] for request in asked] == ["POST"]
    cancel(browser)


@pytest.mark.parametrize("name", ["a.pdf", "a.mp4", "folder"])
def test_each_file_that_is_refused_is_told_why_in_a_line(browser, address, tmp_path, name):
    visit(browser, address)
    (path := tmp_path / name).touch()
    with pytest.raises(CadenzaError) as refused:
        read_score(path)
    if name == "folder":
        browser.evaluate(
            "File.prototype.slice = () => new Response(new ReadableStream("
            "{ start(to) { to.error(new DOMException('gone', 'NotFoundError')); } }))"
        )
        why = "folder: cannot be read; drop a file, no folder"
    else:
        why = str(refused.value).replace(f"{tmp_path}/", "")
    drop(browser, b"\0" * (6 << 20 if name == "a.mp4" else 100), name)
    wait(browser, "cadenza.error !== null")
    assert text(browser, "error") == why
    assert uncaught(browser) == []
    press(browser, ".looks", "Top")  # whatever the visitor does next
    assert browser.evaluate("document.getElementById('error').hidden")


@pytest.mark.parametrize(
    ("fake", "why"),
    [
        (
            "requestMIDIAccess = async () => { throw new DOMException('no', 'NotAllowedError'); }",
            "Allow it MIDI devices",
        ),
        ("requestMIDIAccess = undefined", "from another machine"),
    ],
)
def test_where_a_keyboard_may_not_be_heard_the_page_says_so(browser, address, fake, why):
    source = (
        f"navigator.{fake}; Object.defineProperty(window, 'isSecureContext', {{ value: false }})"
    )
    added = browser.call("Page.addScriptToEvaluateOnNewDocument", source=source)
    visit(browser, address)
    browser.call("Page.removeScriptToEvaluateOnNewDocument", **added)
    assert browser.evaluate("!document.getElementById('keyboard').hidden")
    browser.evaluate("document.getElementById('keyboard').click()")
    wait(browser, "cadenza.error !== null")
    assert why in text(browser, "error")
    assert browser.problems() == []


@pytest.mark.usefixtures("kept")
def test_nothing_of_the_song_before_stands_under_the_next(browser, address):
    visit(browser, address)
    press(browser, "#kept", "Watch")
    browser.evaluate("document.querySelector('.figures').open = true")
    wait(browser, "cadenza.time > 1.2 && document.getElementById('f1').textContent !== '–'")
    browser.evaluate("window.WebSocket = class { close() {} }")  # of the next, nothing is told
    press(browser, "#kept", "Watch")
    browser.settle()
    shown = {name: text(browser, name) for name in (*SCORES, "clock", "length", "facts", "title")}
    assert shown == dict.fromkeys(SCORES, "–") | {
        **{"clock": "0:00.0", "length": "0:00.0"},
        **{"facts": "", "title": "Cadenza studio"},
    }
    assert browser.evaluate("document.getElementById('scrub').value") == "0"
    assert browser.evaluate("document.getElementById('roll-card').hidden")


@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
@pytest.mark.usefixtures("kept")
def test_what_is_chosen_far_below_plays_in_view(browser, address, size):
    screen = {"deviceScaleFactor": 1, "mobile": size[0] < 500}
    browser.call("Emulation.setDeviceMetricsOverride", width=size[0], height=size[1], **screen)
    visit(browser, address)
    place = "document.getElementById('picture').getBoundingClientRect().toJSON()"

    def is_in_view() -> bool:
        browser.settle()
        box = browser.evaluate(place)
        return bool(box["top"] >= -1 and box["bottom"] <= size[1] + 1)

    for act in "#kept button", "[data-song=OdeToJoy]", "#start":  # the last goes on with the same
        browser.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        browser.settle()
        browser.evaluate("window.before = location.hash")
        browser.evaluate(f"document.querySelector('{act}').click()")
        wait(
            browser, f"cadenza.live && ({json.dumps(act)} === '#start' || location.hash !== before)"
        )
        assert is_in_view(), act
    cancel(browser)
    browser.evaluate("window.scrollTo(0, document.body.scrollHeight)")
    drop(browser, b"MThd", "broken.mid")
    wait(browser, "cadenza.error !== null")
    box = browser.evaluate("document.getElementById('error').getBoundingClientRect().toJSON()")
    assert box["top"] >= 0
    assert box["bottom"] <= size[1]
    browser.call(
        "Emulation.setDeviceMetricsOverride",
        **{"width": 1000, "height": 1700, "deviceScaleFactor": 1, "mobile": False},
    )


def test_what_is_played_on_a_keyboard_is_played_after(browser, address):
    fake = (
        "navigator.requestMIDIAccess = async () => ({ inputs: new Map([[1, window.piano = {}]]) })"
    )
    added = browser.call("Page.addScriptToEvaluateOnNewDocument", source=fake)
    visit(browser, address)
    browser.call("Page.removeScriptToEvaluateOnNewDocument", **added)
    browser.evaluate("document.getElementById('keyboard').click()")
    wait(browser, "!!window.piano?.onmidimessage")
    browser.evaluate("""[60, 64, 67].forEach((pitch, i) => {
        piano.onmidimessage({ data: [0xb0, 1, 5], timeStamp: 0 });
        piano.onmidimessage({ data: [0x90, pitch, 80], timeStamp: 1000 + 500 * i });
        piano.onmidimessage({ data: [i ? 0x80 : 0x90, pitch, 0], timeStamp: 1400 + 500 * i });
    })""")
    wait(browser, "cadenza.began")
    assert text(browser, "title").startswith("Played at")
    (song,) = browser.evaluate("""(async () => (await (await fetch("api/songs")).json()).songs
        .filter((song) => song.title.startsWith("Played at")))()""")
    assert song["notes"] == 3
    assert song["seconds"] == pytest.approx(1.4, abs=0.002)
    cancel(browser)


def test_two_users_take_turns(browser, address, tmp_path, tmp_path_factory):
    other = Browser(tmp_path_factory.mktemp("other"))
    try:
        for who, name in (browser, "first.mid"), (other, "second.mid"):
            visit(who, address)
            drop(who, song(tmp_path / name, 4 if who is browser else 5), name)
            wait(who, "cadenza.state !== 'idle'")
        for who, name in (browser, "first"), (other, "second"):
            wait(who, "cadenza.finished")
            assert text(who, "title") == name
            assert who.problems() == []
    finally:
        other.close()


def test_what_was_left_out_of_a_file_is_said(browser, address):
    visit(browser, address)
    file, notes = mido.MidiFile(), mido.MidiTrack()
    notes += [mido.Message("note_on", note=pitch, time=480) for pitch in (60, 64)]  # never released
    file.tracks.append(notes)
    content = io.BytesIO()
    file.save(file=content)
    drop(browser, content.getvalue(), "held.mid")
    wait(browser, "!document.getElementById('remarks').hidden")
    assert "1 note never released" in text(browser, "remarks")
    wait(browser, "cadenza.finished")
    browser.evaluate("document.querySelector('[data-song=OdeToJoy]').click()")
    wait(browser, "cadenza.live && document.title.startsWith('Ode')")
    assert browser.evaluate("document.getElementById('remarks').hidden")
    cancel(browser)


def test_what_a_closed_page_asked_for_can_be_cancelled(browser, address, tmp_path):
    """Others wait for it, and it would go on for long."""
    visit(browser, address)
    drop(browser, song(tmp_path / "long.mid", 2000), "long.mid")
    wait(browser, "cadenza.live")
    assert "Playing long" not in text(browser, "background")  # but in the picture
    visit(browser, address)
    wait(browser, "document.getElementById('works').innerText.includes('Playing long')")
    browser.evaluate("document.querySelector('[data-song=OdeToJoy]').click()")
    waiting = r"/turn: 1 before it; it begins in about \d+ s$/"
    wait(browser, f"{waiting}.test(document.getElementById('doing').innerText)")
    press(browser, "#works", "Cancel")
    wait(browser, "!document.getElementById('works').innerText.includes('Playing')")
    wait(browser, "cadenza.live && document.title.startsWith('Ode')")
    cancel(browser)
    assert browser.problems() == []


@pytest.mark.usefixtures("kept")
def test_nothing_lies_over_the_legend_of_the_picture(browser, address):
    visit(browser, address)
    press(browser, "#kept", "Watch")
    wait(browser, "cadenza.began && !!document.querySelector('#score .note')")
    apart = """((legend, looks) => legend.right <= looks.left || legend.bottom <= looks.top)(
        ...["#stage .legend", "#looks"].map((each) =>
            document.querySelector(each).getBoundingClientRect()))"""
    screen = {"height": 900, "deviceScaleFactor": 1, "mobile": False}
    for width in 390, 701, 901, 1000, 1081, 1181, 1400:
        browser.call("Emulation.setDeviceMetricsOverride", width=width, **screen)
        browser.settle()
        assert browser.evaluate(apart), width
    browser.call("Emulation.setDeviceMetricsOverride", width=1000, **screen | {"height": 1700})


def test_half_an_hour_begins_at_once_and_more_is_refused(browser, address, tmp_path):
    for minutes in 30, 33:
        notes = (Note(60.0 * i, 60.0 * i + 2, 60 + i % 12) for i in range(minutes))
        steady = (Note(0.5 * i, 0.5 * i + 0.4, 72) for i in range(120 * minutes - 119))
        path = tmp_path / f"{minutes}.mid"
        write_midi(Score(tuple(sorted((*notes, *steady), key=lambda note: note.start))), path)
        visit(browser, address)
        drop(browser, path.read_bytes(), path.name)
        wait(browser, "cadenza.began || cadenza.error")
        if minutes == 30:
            assert browser.evaluate("cadenza.error") is None
            assert browser.evaluate("cadenza.live.steps * cadenza.live.dt") > 1700
            cancel(browser)
    assert "half an hour" in text(browser, "error")


def test_a_server_that_ends_is_noticed(browser, tmp_path):
    with studio(tmp_path / "short") as short:
        visit(browser, short)
        drop(browser, song(tmp_path / "e.mid", 60), "e.mid")
        wait(browser, "cadenza.time > 0.5")
    wait(browser, "cadenza.error !== null || cadenza.state === 'cancelled'")
    assert not list((tmp_path / "short").glob(".*"))
    with studio(tmp_path / "short") as again:
        assert again == short
        browser.call("Page.reload")
        wait(browser, "!!window.cadenza && cadenza.ready && cadenza.state === 'gone'")
        assert "Press Play" in text(browser, "doing")
        assert text(browser, "start") == "Play e"
        assert browser.evaluate("document.getElementById('agent').value") == "sight"
        press(browser, ".actions", "Play e")
        wait(browser, "cadenza.began")


def test_a_server_that_is_killed_and_started_again(browser, tmp_path):
    """The page waits for it, and then says what became of the performance."""
    line = [sys.executable, "-m", "cadenza", "studio", "--folder", str(tmp_path / "killed")]
    for turn in range(2):
        with subprocess.Popen([*line, "--no-browser"], stdout=subprocess.PIPE, text=True) as server:
            assert server.stdout is not None
            address = server.stdout.readline().split()[-1]
            if not turn:
                visit(browser, address)
                drop(browser, song(tmp_path / "f.mid", 60), "f.mid")
                wait(browser, "cadenza.time > 0.5")
            else:
                wait(browser, "cadenza.state === 'gone'")
                assert browser.evaluate("cadenza.error") is None
            server.kill()
        if not turn:
            wait(browser, "cadenza.error?.includes('does not answer')")


def test_kept_performances_and_settings_are_found_after_a_restart(browser, folder):
    with studio(folder) as again:  # beside the first, which does not mind
        kept = list(folder.glob("*/studio.json"))
        visit(browser, f"{again}#song=OdeToJoy&hand=allegro&seed=7&tempo=1.5")
        assert "My <b>song" in text(browser, "kept")
        chosen = """[...document.querySelectorAll(".options > label > :is(select, [type=number])")]
            .map((each) => each.value)"""
        assert browser.evaluate(chosen) == ["sight", "allegro", "both", "1.5", "0", "7", ""]
        assert text(browser, "start") == "Play Ode to Joy"
        browser.evaluate("window.confirm = () => true")
        browser.evaluate("document.querySelector('#kept li button:last-child').click()")
        wait(browser, f"document.getElementById('kept').children.length === {len(kept) - 1}")
        assert len(list(folder.glob("*/studio.json"))) == len(kept) - 1


def test_a_song_is_played_with_expression_and_without_signs(browser, address, folder):
    visit(browser, f"{address}#song=MaryHadALittleLamb&expression=true&plain=true&seed=1")
    browser.evaluate("document.getElementById('agent').value = 'sight'")
    assert browser.evaluate("document.getElementById('expression').checked")
    browser.evaluate("document.getElementById('start').click()")
    wait(browser, "cadenza.state === 'kept' && cadenza.finished")
    assert text(browser, "facts").endswith("plain notes · with expression · take 1")
    id = browser.evaluate("location.hash").removeprefix("#job=")
    settings = json.loads((folder / id / "settings.json").read_text())
    assert settings["arrangement"]["expression"] == 1
    assert settings["arrangement"]["plain"]
    expected = load_song("MaryHadALittleLamb", Arrangement(expression=1.0)).notes
    midi = read_score(folder / id / "wanted.mid").notes
    assert [note.velocity for note in midi] == [note.velocity for note in expected]
    wait(
        browser,
        "document.querySelector('#kept li:first-child')?.innerText.includes('with expression')",
    )
    visit(browser, f"{address}#song=MaryHadALittleLamb&expression=false")
    assert not browser.evaluate("document.getElementById('expression').checked")
    assert not browser.evaluate("document.getElementById('plain').checked")
    press(browser, "#kept li:first-child", "Watch")
    wait(browser, "cadenza.began")
    assert browser.evaluate("document.getElementById('expression').checked")
    assert browser.evaluate("document.getElementById('plain').checked")
    browser.evaluate("document.getElementById('expression').checked = false")
    browser.evaluate("document.getElementById('plain').checked = false")
    assert browser.problems() == []


def test_the_page_opens_with_a_song_at_a_click(browser, address):
    browser.call("Page.navigate", url="about:blank")
    browser.call("Page.navigate", url=address)
    wait(browser, "!!document.querySelector('#hands-view canvas')")  # hands that are ready
    assert "Für Elise" in text(browser, "first")
    browser.evaluate("document.getElementById('agent').value = 'sight'")
    browser.evaluate("document.getElementById('first').click()")
    wait(browser, "cadenza.began")
    assert "Für Elise" in text(browser, "title")
    assert browser.evaluate("document.getElementById('first').hidden")
    assert not uncaught(browser)
    cancel(browser)


def test_an_arrangement_is_chosen_and_explained(browser, address, tmp_path):
    chords = tuple(Note(i, i + 0.9, pitch) for i in range(4) for pitch in range(36, 84, 4))
    write_midi(Score(chords), tmp_path / "chords.mid")
    visit(browser, address)
    drop(browser, (tmp_path / "chords.mid").read_bytes(), "chords.mid")
    wait(browser, "cadenza.began")
    losses = "document.getElementById('losses').textContent"
    assert "arranged for both hands: " in browser.evaluate(losses)  # before it has been played
    rows = "[...document.querySelectorAll('#{} tbody tr')].map((row) => row.innerText)"
    changed = browser.evaluate(rows.format("changes"))
    assert any(row.endswith("left out") for row in changed)
    browser.evaluate("document.getElementById('arrange').click()")
    assert browser.evaluate("document.getElementById('level').disabled")
    browser.evaluate("document.getElementById('start').click()")
    wait(browser, "cadenza.state === 'kept' && !!document.querySelector('#misses tbody')")
    assert "as written" in text(browser, "facts")
    assert "arranged for both hands: " not in browser.evaluate(losses)
    assert text(browser, "verdict").endswith("try it arranged for the hands.")
    assert browser.evaluate("document.getElementById('changes').closest('.card').hidden")
    assert browser.evaluate("cadenza.live.fingers.length") > 0  # numbers in the roll
    missed = browser.evaluate(rows.format("misses"))
    assert any("no finger for it" in row for row in missed)
    wait(browser, "document.querySelector('#kept li:first-child')?.innerText.includes('chords')")
    # Watched again, the same is said, in the words of the report.
    press(browser, "#kept li:first-child", "Watch")
    wait(browser, "cadenza.live && !!document.querySelector('#misses tbody')")
    assert browser.evaluate(rows.format("misses")) == missed
    assert not browser.evaluate("document.getElementById('arrange').checked")
    browser.evaluate("document.getElementById('arrange').click()")
    assert not uncaught(browser)


def test_speed_and_loop(browser, address, tmp_path):
    visit(browser, address)
    drop(browser, song(tmp_path / "a.mid"), "a.mid")
    wait(browser, "cadenza.finished && cadenza.state === 'kept'")
    browser.evaluate("document.getElementById('loop').click()")
    browser.evaluate("""(() => {
        const speed = document.getElementById("speed");
        speed.value = "2";
        speed.dispatchEvent(new Event("change"));
        window.strikes = cadenza.strikes.length;
        document.getElementById("play").click();
    })()""")
    wait(browser, "cadenza.time > 0.3")
    # Both clocks in each frame: the song's, and the sound's, which a busy machine holds up.
    frames = browser.evaluate("""(async () => {
        const frames = [], begin = performance.now();
        while (performance.now() < begin + 3000) {
            await new Promise(requestAnimationFrame);
            frames.push([cadenza.instrument.time, cadenza.time]);
        }
        return frames;
    })()""")
    sound, music = np.diff(frames, axis=0).T
    assert (music < 0).any()  # where it begins again
    assert music[music > 0].sum() == pytest.approx(2 * sound[music > 0].sum(), rel=0.05)
    wait(browser, "cadenza.strikes.slice(strikes).filter(([due]) => due < 0.8).length > 1")
    late = [abs(at - due) for due, _, at in browser.evaluate("cadenza.strikes.slice(strikes)")]
    assert np.median(late) < 0.04
    browser.evaluate("document.getElementById('loop').click()")
    wait(browser, "cadenza.finished")
    assert not uncaught(browser)
