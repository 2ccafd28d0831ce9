"""Measures the studio by the clock, in a browser, on a machine that has nothing else to do.

    python tools/measure_studio.py [FILE ...] [--seconds S]

It prints how fast the machine is, in simulated control steps a second; how long the page takes to
show anything; how long after a click the first note of each bundled piece sounds; the same of
files that are dropped, and how long playing waits for the planner in the first S seconds of their
music; and how many pictures a second the page draws meanwhile. It needs Chromium.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from cadenza.scene.scene import build_scene  # noqa: E402
from headless import Browser  # noqa: E402

SIZE = {"width": 1280, "height": 720, "deviceScaleFactor": 1, "mobile": False}
BETWEEN = 3.0  # [s] for which the machine rests between two songs
LONGEST = 120.0  # [s] until a first note is given up
FPS_OVER = 5.0  # [s]
# Of the song asked for last: [ms] until its first note sounds, and for which it has waited since.
WATCH = """
    Object.assign(cadenza, { strikes: [], time: 0, began: null, finished: false });
    clearInterval(window.watching);
    window.measured = { heard: null, waited: 0 };
    (() => {
        const asked = performance.now(), old = cadenza.live, { measured } = window;
        let last = asked;
        window.watching = setInterval(() => {
            const now = performance.now(), isNew = cadenza.live && cadenza.live !== old;
            const [first] = isNew ? cadenza.strikes : [];
            if (first && cadenza.time >= first[0]) measured.heard ??= now - asked;
            const waits = isNew && cadenza.began && !cadenza.finished && !document.getElementById("notice").hidden;
            if (waits) measured.waited += now - last;
            last = now;
        }, 10);
    })();
"""  # noqa: E501
DROP = """
    const bytes = Uint8Array.from(atob("{data}"), (c) => c.charCodeAt(0));
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File([bytes], {name}));
    document.body.dispatchEvent(new DragEvent("drop", {{ dataTransfer, bubbles: true }}));
"""
FRAMES = f"""new Promise((done) => {{
    const begin = performance.now(), draw = CanvasRenderingContext2D.prototype.clearRect;
    let drawn = 0;
    CanvasRenderingContext2D.prototype.clearRect = function (...box) {{
        if (this.canvas.closest("#halves")) drawn++;
        draw.apply(this, box);
    }};
    const watching = setInterval(() => {{
        const spent = performance.now() - begin;
        if (spent < {1000 * FPS_OVER} && cadenza.state === "playing") return;
        clearInterval(watching);
        CanvasRenderingContext2D.prototype.clearRect = draw;
        done((1000 * drawn) / spent);
    }}, 10);
}})"""


def control_steps_a_second(count: int = 600) -> float:
    """Simulates two hands that move at random, and returns control steps a second."""
    model = build_scene().model
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    low, high = model.actuator_ctrlrange.T
    begin = time.perf_counter()
    for _ in range(count):
        data.ctrl[:] = rng.uniform(low, high)
        mujoco.mj_step(model, data, 10)
    return count / (time.perf_counter() - begin)


@contextmanager
def page() -> Iterator[Browser]:
    """Yields the page of a studio of its own, when its player is ready."""
    with tempfile.TemporaryDirectory() as folder:
        command = ["studio", "--folder", f"{folder}/played", "--no-browser"]
        server = subprocess.Popen(
            [sys.executable, "-m", "cadenza", *command], stdout=subprocess.PIPE, text=True
        )
        assert server.stdout is not None
        browser = Browser(Path(folder) / "profile")
        try:
            browser.call("Emulation.setDeviceMetricsOverride", **SIZE)
            browser.call("Page.navigate", url=server.stdout.readline().split()[-1])
            browser.wait("!!window.cadenza && cadenza.ready")
            time.sleep(2 * BETWEEN)
            yield browser
        finally:
            browser.close()
            server.terminate()
            server.wait()


def ask_for(browser: Browser, song: str) -> None:
    """Asks for a bundled piece by a click, and for a file by dropping it."""
    if not Path(song).is_file():
        browser.evaluate(f"location.hash = 'song={song}'")
        time.sleep(0.5)
        browser.evaluate(f"{WATCH} document.getElementById('start').click()")
        return
    data = base64.b64encode(Path(song).read_bytes()).decode()
    drop = DROP.format(data=data, name=json.dumps(Path(song).name))
    browser.evaluate(f"(() => {{ {WATCH} {drop} }})()")


def play(browser: Browser, song: str, seconds: float) -> dict[str, Any]:
    """Plays so much of a song [s], and returns what was measured."""
    load = os.getloadavg()[0]
    ask_for(browser, song)
    browser.wait("measured.heard !== null || cadenza.error", LONGEST)
    browser.wait(f"cadenza.time >= {seconds} || cadenza.finished || cadenza.error", 10 * LONGEST)
    found = browser.evaluate("({ ...measured, waits: cadenza.waits, error: cadenza.error })")
    browser.evaluate("document.getElementById('cancel').click()")
    time.sleep(BETWEEN)
    return found | {"load": load}


def frames(browser: Browser) -> float:
    """Pictures of the flat view a second, while it plays and is being planned."""
    ask_for(browser, "FurEliseOpening")
    browser.wait("measured.heard !== null", LONGEST)
    return float(browser.evaluate(FRAMES))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("files", nargs="*")
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    print(f"plain mj_step: {control_steps_a_second():.0f} control steps a second")
    with page() as browser:
        paints = browser.evaluate("performance.getEntriesByType('paint').map((p) => p.startTime)")
        print(f"first picture: {min(paints, default=0) / 1000:.2f} s after the page is asked for")
        songs = "(async () => (await (await fetch('api/songs')).json()).songs.map((s) => s.id))()"
        bundled = browser.evaluate(songs)
        print(f"{'song':40} {'load':>5} {'first note':>10} {'waits':>5} {'waiting':>8}")
        worst = 0.0
        for song, seconds in [(s, 0.0) for s in bundled] + [
            (s, options.seconds) for s in options.files
        ]:
            found = play(browser, song, seconds)
            if found["error"]:
                print(f"{Path(song).stem[:40]:40} {found['error']}")
                continue
            heard = found["heard"] / 1000
            worst = max(worst, heard) if not seconds else worst
            line = f"{Path(song).stem[:40]:40} {found['load']:5.2f} {heard:8.2f} s"
            if seconds:
                line += f" {found['waits']:5} {found['waited'] / 1000:6.1f} s"
            print(line, flush=True)
        print(f"latest first note of a bundled piece: {worst:.2f} s")
        print(f"flat view while it is planned: {frames(browser):.0f} pictures a second")


if __name__ == "__main__":
    main()
