"""Chromium without a window, spoken to through its DevTools protocol over a pair of pipes."""

import base64
import io
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

CHROMIUM = (
    shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
)
# Of each canvas, what has been written on it since it was cleared: text, left, top, right, bottom.
_WRITTEN = """(() => {
    const written = window.written = new WeakMap(), drawing = CanvasRenderingContext2D.prototype;
    const { fillText, clearRect } = drawing;
    drawing.clearRect = function (...box) {
        written.delete(this.canvas);
        clearRect.apply(this, box);
    };
    drawing.fillText = function (text, x, y, ...width) {
        const size = this.measureText(text), { a, d, e, f } = this.getTransform();
        const box = [a * (x - size.actualBoundingBoxLeft) + e,
            d * (y - size.actualBoundingBoxAscent) + f, a * (x + size.actualBoundingBoxRight) + e,
            d * (y + size.actualBoundingBoxDescent) + f];
        const texts = written.get(this.canvas) ?? [];
        if (text !== "") written.set(this.canvas, [...texts, [String(text), ...box]]);
        fillText.call(this, text, x, y, ...width);
    };
})()"""
_COLLIDING = """(canvas) => {
    const { width, height } = canvas, texts = written.get(canvas) ?? [];
    const out = ([, left, top, right, bottom]) =>
        left < -1 || top < -1 || right > width + 1 || bottom > height + 1;
    const over = ([, left, top, right, bottom], [, left2, top2, right2, bottom2]) =>
        left < right2 && left2 < right && top < bottom2 && top2 < bottom;
    return [
        ...texts.filter(out).map(([text]) => `${text} is cut off`),
        ...texts.flatMap((a, i) => texts.slice(i + 1).filter((b) => over(a, b))
            .map(([text]) => `${text} over ${a[0]}`)),
    ];
}"""
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium or Chrome on the PATH")


class Browser:
    """One page of a browser of its own; `events` holds what the browser reported."""

    def __init__(self, profile: Path, *flags: str) -> None:
        their_in, our_out = os.pipe()
        our_in, their_out = os.pipe()
        command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", *flags]
        command += ["--remote-debugging-pipe", f"--user-data-dir={profile}"]
        onto_3_and_4 = f'exec "$@" 3<&{their_in} 4>&{their_out}'
        self.process = subprocess.Popen(
            ["bash", "-c", onto_3_and_4, "bash", *command],
            pass_fds=(their_in, their_out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(their_in), os.close(their_out)
        self.output, self.input = os.fdopen(our_out, "wb", 0), os.fdopen(our_in, "rb")
        self.events: list[dict[str, Any]] = []
        self.calls, self.session = 0, None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=_WRITTEN)
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=1000,
            height=1700,
            deviceScaleFactor=1,
            mobile=False,
        )

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        self.calls += 1
        message = {"id": self.calls, "method": method, "params": params}
        self.output.write(
            json.dumps(message | ({"sessionId": self.session} if self.session else {})).encode()
            + b"\0"
        )
        while True:
            answer = self._read()
            if answer.get("id") == self.calls:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self.events.append(answer)

    def _read(self) -> dict[str, Any]:
        text = bytearray()
        while (byte := self.input.read(1)) != b"\0":
            assert byte, "the browser has gone"
            text += byte
        return json.loads(text)

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression, awaited, as if a user had clicked."""
        answer = self.call(
            "Runtime.evaluate",
            expression=script,
            awaitPromise=True,
            returnByValue=True,
            userGesture=True,
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition: str, seconds: float = 40) -> None:
        end = time.monotonic() + seconds
        while not self.evaluate(condition):
            assert time.monotonic() < end, (
                f"{condition} did not come true; {str(self.problems())[:3000]}"
            )
            time.sleep(0.05)

    def open(self, page: Path) -> None:
        self.events.clear()
        self.call("Page.navigate", url=page.as_uri())
        self.wait("!!window.cadenza && (cadenza.ready || cadenza.error !== null)")
        assert self.evaluate("cadenza.error") is None
        self.settle()

    def settle(self) -> None:
        self.evaluate(
            "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
        )

    def picture(self, selector: str) -> np.ndarray:
        """The element's pixels (H, W, 3)."""
        self.settle()
        box = self.evaluate(
            f"document.querySelector('{selector}').getBoundingClientRect().toJSON()"
        )
        box = {name: box[name] for name in ("x", "y", "width", "height")}
        shot = self.call("Page.captureScreenshot", format="png", clip=box | {"scale": 1})["data"]
        with av.open(io.BytesIO(base64.b64decode(shot)), format="png_pipe") as file:
            return next(file.decode(video=0)).to_ndarray(format="rgb24")

    def labels(self) -> list[list[str]]:
        """The texts on each canvas of the page, in order."""
        return self.evaluate("""[...document.querySelectorAll("canvas")]
            .map(canvas => (written.get(canvas) ?? []).map(([text]) => text))""")

    def colliding_labels(self, canvases: str = "canvas") -> list[str]:
        """Texts on a canvas that lie over each other or are cut off by its edges."""
        return self.evaluate(f"[...document.querySelectorAll('{canvases}')].flatMap({_COLLIDING})")

    def problems(self) -> list[str]:
        """Exceptions and errors on the console."""
        kinds = {
            "Runtime.exceptionThrown": bool,
            "Runtime.consoleAPICalled": lambda p: p["type"] in ("error", "warning", "assert"),
            "Log.entryAdded": lambda p: p["entry"]["level"] == "error",
        }
        return [
            json.dumps(e)
            for e in self.events
            if e["method"] in kinds and kinds[e["method"]](e["params"])
        ]

    def loaded(self) -> list[str]:
        return [
            e["params"]["request"]["url"]
            for e in self.events
            if e["method"] == "Network.requestWillBeSent"
        ]

    def close(self) -> None:
        self.process.terminate()
        self.process.wait()
        self.output.close(), self.input.close()
