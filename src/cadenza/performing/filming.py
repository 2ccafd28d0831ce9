"""Films of a performance, drawn by its page in a browser, and its sound alone."""

import io
import json
import os
import queue
import secrets
import shutil
import subprocess
import sys
import threading
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from subprocess import DEVNULL
from tempfile import TemporaryDirectory
from typing import IO, Any
from urllib.parse import quote

import av

from cadenza.agents.agent import Progress, silent
from cadenza.cameras import VIEWS
from cadenza.episode import load_episode
from cadenza.errors import CadenzaError, quoted
from cadenza.files import write_atomically
from cadenza.music.performance import played_in
from cadenza.report.sound import CODECS, SAMPLE_RATE, Samples, synthesize, write_audio, write_sound
from cadenza.report.tone import Tone, tone

FILM = "video.mp4"  # the name of the film in the folder of a performance
_ENDING = ".mp4"
_MIN_SIDE, _MAX_SIDE = 64, 2160  # [px]
_PATIENCE = 300.0  # [s] with a browser that sends nothing
_NAMES = "google-chrome", "google-chrome-stable", "chromium", "chromium-browser", "microsoft-edge"
_FLAGS = (
    *("--headless", "--no-first-run", "--mute-audio", "--disable-dev-shm-usage"),
    *("--enable-unsafe-swiftshader", "--force-color-profile=srgb"),  # draws where there is no card
    "--disable-gpu-watchdog",  # which ends what draws on a busy machine, and the film with it
)
_POLICY = "default-src 'none';"


@dataclass(frozen=True)
class Look:
    """What a film shows: its size [px], a camera of `VIEWS`, and the score below if `score`.

    It begins at `start` [s] of the performance, and lasts `seconds` [s], or to the end.
    """

    width: int = 1920
    height: int = 1080
    camera: str = "player"
    score: bool = False
    start: float = 0.0
    seconds: float | None = None

    def __post_init__(self) -> None:
        """Check size and camera.

        Raises CadenzaError if the film is too small, too large or of an odd size, or there is no
        such camera.
        """
        sides = self.width, self.height
        if not (min(sides) >= _MIN_SIDE and max(sides) <= _MAX_SIDE) or any(s % 2 for s in sides):
            raise CadenzaError(
                f"a film of {self.width} x {self.height} pixels: choose even numbers from "
                f"{_MIN_SIDE} to {_MAX_SIDE} for each side"
            )
        if self.camera not in VIEWS:
            raise CadenzaError(f"no camera {quoted(self.camera)}: choose from {', '.join(VIEWS)}")


def write_film(
    folder: Path,
    path: Path | None = None,
    look: Look | None = None,
    voice: Tone = tone,
    progress: Progress = silent,
) -> Path:
    """Write the film of a performance, or its sound alone, by the ending of the name.

    `folder` is what `Performance.save` wrote, `FILM` in it the film by default.

    Raises CadenzaError if the folder holds no performance, the file has another ending, there is
    nothing to show, or no browser that can draw it. Returns the file.
    """
    path, look, page = path or folder / FILM, look or Look(), folder / "report.html"
    is_film = path.suffix.lower() == _ENDING
    if path.is_dir():
        raise CadenzaError(f"{path}: is a folder; choose another name")
    if not (is_film or path.suffix.lower() in CODECS):
        raise CadenzaError(
            f"{path}: a film is an {_ENDING}, and the sound alone a {', '.join(CODECS)} file; "
            "choose a name with one of these endings"
        )
    if not (page.is_file() and (folder / "episode.npz").is_file()):
        raise CadenzaError(
            f'{folder}: holds no performance (episode.npz); make one with "cadenza play SONG", and '
            "give the folder of its results, such as played/SONG/planner"
        )
    episode = load_episode(folder / "episode.npz")
    length, start = episode.num_steps * episode.dt, look.start
    end = length if look.seconds is None else min(start + look.seconds, length)
    if not 0 <= start < end:
        raise CadenzaError(
            f"nothing to show from {start:g} s to {end:g} s: what was played lasts {length:.1f} s"
        )
    browser = find_browser() if is_film else ""
    sound = synthesize(played_in(episode), voice=voice)
    last = None if look.seconds is None else round(end * SAMPLE_RATE)  # or it rings on
    audio = sound[round(start * SAMPLE_RATE) : last]
    if not is_film:
        write_sound(path, audio, seconds=end - start)
        return path
    options = asdict(look) | {"end": end, "silent": True}
    _add_sound(_drawn(page.read_text("utf-8"), browser, options, progress), audio, path)
    return path


def find_browser() -> str:
    """Find the Chrome, Chromium or Edge of this machine.

    Raises CadenzaError if there is none. Returns its path.
    """
    browser = next(filter(None, map(shutil.which, _NAMES)), None)
    if browser is None:
        raise CadenzaError(
            "a film is drawn by Chrome, Chromium or Edge, and none is here: install one (on Debian "
            'and Ubuntu, "apt install chromium"), or press Film on the page report.html elsewhere'
        )
    return browser


def _drawn(page: str, browser: str, options: dict[str, Any], progress: Progress) -> IO[bytes]:
    """The film with these options, without sound, as a browser draws and sends it.

    Raises CadenzaError if the browser ends, sends nothing for five minutes, or cannot draw.
    """
    token, events = secrets.token_urlsafe(16), queue.Queue[tuple[list[str], bytes]]()
    page_with_access = page.replace(
        _POLICY, f"{_POLICY} connect-src 'self';", 1
    )  # to send its film here

    class Handler(BaseHTTPRequestHandler):
        """The handler of requests of the page, which sends its film here."""

        def do_GET(self) -> None:
            _, sent_token, *words = self.path.split("/")
            is_known, is_sent = sent_token == token, self.command == "POST"
            if is_known and is_sent:
                events.put((words, self.rfile.read(int(self.headers["content-length"] or 0))))
            self.send_response(200 if is_known else 404)
            self.send_header("content-type", "text/html; charset=utf-8")
            self.end_headers()
            if is_known and not is_sent:
                self.wfile.write(page_with_access.encode("utf-8", "replace"))

        def do_POST(self) -> None:
            self.do_GET()

        def log_message(self, *_: object) -> None:
            """Print nothing."""

    with (
        ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server,
        TemporaryDirectory(ignore_cleanup_errors=True) as profile,
        ExitStack() as ends,
    ):
        threading.Thread(target=server.serve_forever, daemon=True).start()
        ends.callback(server.shutdown)
        flags = [*_FLAGS, f"--user-data-dir={profile}"]
        if sys.platform == "linux" and os.geteuid() == 0:
            flags.append("--no-sandbox")  # it refuses to run as root otherwise; the page is our own
        address = (
            f"http://127.0.0.1:{server.server_port}/{token}/?film={quote(json.dumps(options))}"
        )
        process = subprocess.Popen([browser, *flags, address], stdout=DEVNULL, stderr=DEVNULL)
        ends.enter_context(process)
        ends.callback(process.terminate)

        def watch() -> None:
            process.wait()
            events.put((["error"], b"it has ended"))

        threading.Thread(target=watch, daemon=True).start()
        while True:
            try:
                (kind, *words), body = events.get(timeout=_PATIENCE)
            except queue.Empty:
                raise CadenzaError("the browser that draws the film sends nothing") from None
            if kind == "film":
                return io.BytesIO(body)
            if kind == "error":
                raise CadenzaError(f"the browser cannot draw the film: {body.decode()}")
            progress("drawing", *map(int, words))


def _add_sound(film: IO[bytes], audio: Samples, path: Path) -> None:
    """Write a film with AAC sound, which any player plays, and the pictures as they are."""
    with (
        write_atomically(path) as file,
        av.open(film, "r") as drawn,
        av.open(file, "w", format="mp4", options={"movflags": "faststart"}) as container,
    ):
        (pictures,) = drawn.streams.video
        copy = container.add_stream_from_template(pictures)
        sound = container.add_stream("aac", rate=SAMPLE_RATE, layout="stereo")
        for packet in drawn.demux(pictures):
            if packet.dts is not None:
                packet.stream = copy
                container.mux(packet)
        write_audio(container, sound, audio, len(audio))
