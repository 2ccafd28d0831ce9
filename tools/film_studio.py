"""Makes the moving picture of the studio: a page on which the opening of Für Elise is played.

    python tools/film_studio.py

writes docs/studio.webp. It needs Chromium.
"""

from __future__ import annotations

import argparse
import base64
import io
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray
from write_readme_media import write_webp

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from headless import Browser  # noqa: E402

SONG, FIRST, LAST, FPS = "FurEliseOpening", 1.0, 11.0, 10
SIZE = {"width": 1280, "height": 800, "deviceScaleFactor": 0.75, "mobile": False}
# The page's clock is ours, and there is no sound, which would be another.
SCRIPT = """
    window.clock = null;
    const now = performance.now.bind(performance);
    performance.now = () => window.clock ?? now();
    Object.defineProperty(AudioContext.prototype, "state", { get: () => "suspended" });
"""


def pictures(browser: Browser, address: str) -> Iterator[NDArray[np.uint8]]:
    browser.call("Page.addScriptToEvaluateOnNewDocument", source=SCRIPT)
    browser.call("Emulation.setDeviceMetricsOverride", **SIZE)
    browser.call("Page.navigate", url=f"{address}#song={SONG}")
    browser.wait("!!window.cadenza && cadenza.ready", 300)
    browser.evaluate("document.getElementById('more').open = false")
    browser.evaluate("document.getElementById('start').click()")
    browser.wait("cadenza.state === 'kept'", 3000)
    browser.wait("cadenza.finished", 3000)
    browser.evaluate("document.getElementById('notice').style.display = 'none'")
    browser.evaluate("window.clock = performance.now(); document.getElementById('play').click()")
    for i in range(round(LAST * FPS)):
        browser.settle()
        if i >= FIRST * FPS:
            shot = browser.call("Page.captureScreenshot", format="png")["data"]
            with av.open(io.BytesIO(base64.b64decode(shot)), format="png_pipe") as file:
                yield next(file.decode(video=0)).to_ndarray(format="rgb24")
        browser.evaluate(f"window.clock += {1000 / FPS}")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        command = ["studio", "--folder", f"{folder}/played", "--no-video", "--no-browser"]
        process = subprocess.Popen(
            [sys.executable, "-m", "cadenza", *command], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        browser = Browser(Path(folder) / "profile")
        try:
            write_webp(ROOT / "docs" / "studio.webp", pictures(browser, address), FPS)
        finally:
            browser.close()
            process.terminate()
            process.wait()


if __name__ == "__main__":
    argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0]).parse_args()
    main()
