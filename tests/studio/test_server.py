"""The server without a browser: who may talk to it, and what it answers."""

import asyncio
import errno
import io
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from asyncio.subprocess import PIPE
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

pytest.importorskip("starlette", reason="needs cadenza[studio]")
pytest.importorskip("uvicorn", reason="needs cadenza[studio]")
pytest.importorskip("httpx2", reason="needs the development group")

from anyio import to_process
from starlette.requests import ClientDisconnect, Request
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from cadenza.errors import CadenzaError
from cadenza.files import write_json
from cadenza.music.formats.midi import write_midi
from cadenza.music.formats.reading import read_score
from cadenza.music.score import Note, Score
from cadenza.studio import jobs, server
from cadenza.studio.page_server import serve
from cadenza.studio.request import HEADER_FILE, ROWS_FILE, PlayRequest
from cadenza.studio.server import Studio
from cadenza.studio.state_stream import json_message
from cadenza.studio.storage import KeptPerformance
from cadenza.studio.tone_samples import Synthesizer

ADDRESS = "http://127.0.0.1:8000"
SAME = {"origin": ADDRESS}


@pytest.fixture
def client(tmp_path, monkeypatch):
    async def nothing(self: Any) -> None:
        pass

    monkeypatch.setattr(jobs.JobQueue, "start_player", nothing)
    studio = Studio(tmp_path / "studio", at_once=0)  # jobs stay in the queue
    app = studio.app("TOKEN", "127.0.0.1")
    with TestClient(app, base_url=ADDRESS) as client:
        yield client


def test_the_page_and_its_parts_are_there(client):
    page = client.get("/TOKEN/")
    assert page.status_code == 200
    assert "default-src 'none'" in page.headers["content-security-policy"]
    parts = [client.get(f"/TOKEN/{name}") for name in ("studio.css", "studio.js", "three.js")]
    assert all(part.status_code == 200 for part in parts)
    assert len(page.content) + sum(len(part.content) for part in parts) < 1_000_000
    assert "&#" not in parts[0].text  # nothing is escaped
    assert client.get("/TOKEN/guard.py").status_code == 404


def test_the_page_opens_with_hands_at_a_piano(client):
    songs = client.get("/TOKEN/api/songs").json()
    assert songs["first"] in {song["id"] for song in songs["songs"]}
    assert songs["hands"]["shadow"] == "Shadow Dexterous Hand"
    picture = client.get("/TOKEN/api/opening").json()
    assert len(picture["scene"]["keys"]) == picture["keys"] == 88
    assert picture["notes"]


def test_a_host_may_be_given_in_capitals(tmp_path):
    app = Studio(tmp_path / "studio").app("TOKEN", "MyBox")
    with TestClient(app, base_url="http://mybox:8000") as browser:
        assert browser.get("/TOKEN/").status_code == 200
        assert browser.get("/TOKEN/", headers={"host": "other:8000"}).status_code == 403


def test_others_are_refused(client):
    for path, headers in (
        *((path, {}) for path in ("/", "/WRONG/", "/TOKENx/", "/t%C3%B6ken/")),
        *(("/TOKEN/", {"host": host}) for host in ("evil.example:8000", "")),
        ("/TOKEN/api/songs", {"origin": "http://evil.example"}),
        ("/TOKEN/api/songs", {"origin": "null"}),
        ("/TOKEN/api/songs", {"origin": "http://127.0.0.1:9000"}),
    ):
        answer = client.get(path, headers=headers)
        assert (answer.status_code, answer.text.count("\n")) == (403, 1), (path, headers)


def test_nothing_changes_without_an_origin(client):
    for method, path in [("POST", "jobs"), ("POST", "songs"), ("DELETE", "performances/x")]:
        assert client.request(method, f"/TOKEN/api/{path}").status_code == 403


def test_others_cannot_watch(client):
    for path, headers in (
        ("/TOKEN/watch/x", {}),
        ("/TOKEN/watch/x", {"origin": "http://evil.example"}),
        ("/WRONG/watch/x", SAME),
        ("/TOKEN/watch/x", SAME | {"host": "evil.example"}),
    ):
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect(f"ws://127.0.0.1:8000{path}", headers=headers),
        ):
            pass
    with client.websocket_connect("ws://127.0.0.1:8000/TOKEN/watch/x", headers=SAME) as socket:
        assert socket.receive_json() == {"state": "gone"}


def test_a_tone_is_made_for_who_asks(client):
    answer = client.get("/TOKEN/tones/60/3")
    samples = np.frombuffer(answer.content[4:], "<i2")
    assert np.abs(samples).max() == 32767
    assert np.frombuffer(answer.content[:4], "<f4") > 0
    assert "immutable" in answer.headers["cache-control"]
    for wrong in (
        *("60/4", "128/0", "60/99999", "9" * 5000 + "/1", "1/" + "9" * 5000, "-1/1", "1.5/1"),
        *("1e3/1", "NaN/1", "inf/1", "%D9%A3/1", "%C2%B2/1", "%00/1", "%20/1", "+1/1", "1_0/1"),
    ):
        answer = client.get(f"/TOKEN/tones/{wrong}")
        assert answer.status_code == 400, wrong
        assert answer.json() == {"error": "there is no such tone"}


@pytest.mark.parametrize("name", ["seed", "transpose", "tempo", "tracks", "song"])
def test_numbers_that_are_none_are_refused_in_a_line(client, name):
    allowed = {"tempo": "1.5", "transpose": "-1"}.get(name)
    for value in {"9" * 5000, "-1", "1e400", "NaN", "[" * 5000, "1.5", "true"} - {allowed}:
        asked = {"song": '"OdeToJoy"', name: f"[{value}]" if name == "tracks" else value}
        body = ",".join(f'"{key}":{text}' for key, text in asked.items())
        answer = client.post("/TOKEN/api/jobs", content=f"{{{body}}}", headers=SAME)
        assert answer.status_code == 400, value
        assert "\n" not in answer.json()["error"]


def test_a_length_that_is_none_is_refused(client):
    for length in "9" * 5000, "-1", "1e3", "+1", "\u00b2":
        headers = {**SAME, "content-length": length.encode("latin-1")}
        answer = client.post("/TOKEN/api/songs?name=a.mid", content=b"MThd", headers=headers)
        assert answer.status_code == 400, length
        assert "larger than" in answer.json()["error"]


def test_a_file_of_another_format_gets_the_answer_of_the_command_line(client, tmp_path):
    content = b"\0" * (5 << 20)  # more than a file of music may have
    for name in "a.WAV", "a.pdf", "a.mscz", "a.webm":
        answer = client.post(f"/TOKEN/api/songs?name={name}", content=content, headers=SAME)
        (tmp_path / name).touch()
        with pytest.raises(CadenzaError) as refused:
            read_score(tmp_path / name)
        assert answer.status_code == 400
        assert answer.json()["error"] == str(refused.value).replace(f"{tmp_path}/", "")


def test_what_is_kept_is_told_again(client, tmp_path):
    id, request = "0123456789abcdef", PlayRequest("OdeToJoy")
    folder, rows = tmp_path / "studio" / id, bytes(range(256)) * 4000  # more than is sent at once
    folder.mkdir()
    write_json(folder / "studio.json", asdict(KeptPerformance("Ode", request, "Well.", 8.0, 1.0)))
    (folder / HEADER_FILE).write_bytes(b'{"steps": 3}')
    (folder / ROWS_FILE).write_bytes(rows)
    (kept,) = client.get("/TOKEN/api/performances").json()
    assert kept["has_states"]
    with client.websocket_connect(f"ws://127.0.0.1:8000/TOKEN/watch/{id}", headers=SAME) as socket:
        message = socket.receive_json()
        assert (message["title"], message["request"]["song"]) == ("Ode", "OdeToJoy")
        assert socket.receive_json()["state"] == "kept"
        assert socket.receive_json() == {"steps": 3}
        sound = b""
        while len(sound) < len(rows):
            sound += socket.receive_bytes()
        assert sound == rows
        with pytest.raises(WebSocketDisconnect):
            socket.receive_bytes()
    for spoil in (
        lambda: (folder / HEADER_FILE).write_bytes(b"\xff{"),
        (folder / ROWS_FILE).unlink,
    ):
        spoil()
        url = f"ws://127.0.0.1:8000/TOKEN/watch/{id}"
        with client.websocket_connect(url, headers=SAME) as socket:
            assert socket.receive_json() == {"state": "gone"}


def test_no_link_leads_out_of_what_is_kept(client, tmp_path):
    secret = tmp_path / "secret"
    secret.write_text("secret")
    studio, request = tmp_path / "studio", PlayRequest("OdeToJoy")
    own, linked = studio / "0123456789abcdef", studio / "fedcba9876543210"
    own.mkdir()
    write_json(own / "studio.json", asdict(KeptPerformance("Ode", request, "Well.", 8.0, 1.0)))
    for name in "report.html", HEADER_FILE, ROWS_FILE:
        (own / name).symlink_to(secret)
    linked.symlink_to(own)
    for folder in own, linked:
        answer = client.get(f"/TOKEN/performances/{folder.name}/report.html")
        assert (answer.status_code, "secret" in answer.text) == (400, False)
        url = f"ws://127.0.0.1:8000/TOKEN/watch/{folder.name}"
        with client.websocket_connect(url, headers=SAME) as socket:
            assert socket.receive_json() == {"state": "gone"}
    (listed,) = client.get("/TOKEN/api/performances").json()
    assert (listed["files"], listed["has_states"]) == ([], False)


WEIRD = {  # contents of a JSON file
    "not text": b"\xff\xfe\xff",
    "deep": b"[" * 100_000,
    "another": b'{"id": "fedcba9876543210", "title": "x", "ending": ".mid", "seconds": 1, '
    b'"notes": 1}',
    "elsewhere": b'{"id": "0123456789abcdef", "title": "x", "ending": "/../../../etc/passwd", '
    b'"seconds": 1, "notes": 1}',
    "no tracks": b'{"id": "0123456789abcdef", "title": "x", "ending": ".mid", "seconds": 1, '
    b'"notes": 1, "tracks": [{"name": 5}]}',
    "no request": b'{"title": "x", "request": {}, "verdict": "", "seconds": 1, "finished": 1}',
}


def weird(path: Path, kind: str) -> None:
    """Put something of the wrong kind there, an hour ago and more."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "loop":
        path.symlink_to(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.write_bytes(WEIRD[kind])
    os.utime(path, (0, 0), follow_symlinks=False)


@pytest.mark.parametrize("kind", ["loop", "folder", "pipe", *WEIRD])
def test_whatever_lies_in_the_folders_the_lists_are_there(client, tmp_path, kind):
    id, studio = "0123456789abcdef", tmp_path / "studio"
    for path in (
        *(studio / "uploads" / f"{name}.json" for name in (id, "x", ".cadenza-1")),
        *(
            studio / "uploads" / name
            for name in (f"{id}.mid", "fedcba9876543210.mid", ".cadenza-2")
        ),
        *(studio / name for name in (f".{id}", "1" * 16, f"{'2' * 16}/studio.json", ".cadenza-3")),
    ):
        weird(path, kind)
    for _ in range(2):
        for name in "songs", "performances":
            answer = client.get(f"/TOKEN/api/{name}")
            assert answer.status_code == 200, answer.text
        assert not any(song["uploaded"] for song in client.get("/TOKEN/api/songs").json()["songs"])
        for method, path in (("DELETE", "songs"), ("DELETE", "performances")):
            gone = client.request(method, f"/TOKEN/api/{path}/{id}", headers=SAME)
            assert "\n" not in gone.json()["error"] if gone.content else True
        job = client.post("/TOKEN/api/jobs", json={"song": id}, headers=SAME)
        assert job.json()["error"].startswith("there is no such song")
        Studio(studio)  # starts again


def test_lists_survive_what_vanishes_while_they_are_made(client, tmp_path, monkeypatch):
    studio, glob = tmp_path / "studio", Path.glob
    (studio / "0123456789abcdef").mkdir()
    (studio / "0123456789abcdef" / "studio.json").write_text("{}")
    (studio / "uploads" / "0123456789abcdef.json").write_text("{}")

    def then_gone(path: Path, pattern: str) -> list[Path]:
        paths = list(glob(path, pattern))
        shutil.rmtree(path, ignore_errors=True)
        return paths

    monkeypatch.setattr(Path, "glob", then_gone)
    for name in "songs", "performances":
        assert client.get(f"/TOKEN/api/{name}").status_code == 200
        (studio / "uploads").mkdir(parents=True, exist_ok=True)


def test_a_file_that_is_deleted_before_it_is_sent_is_not_there(client, tmp_path, monkeypatch):
    gone = tmp_path / "gone.html"
    monkeypatch.setattr("cadenza.studio.storage.Storage.file", lambda *_: gone)
    answer = client.get("/TOKEN/performances/0123456789abcdef/report.html")
    assert (answer.status_code, answer.json()) == (404, {"error": "there is no such file"})


def address_of(folder: Path, known: Path | None = None) -> str:
    """The address of a studio that stops as soon as it prints it."""
    messages = list[str]()

    def stop(address: str) -> None:
        messages.append(address)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        serve(Studio(folder).app, ready=stop, address_file=known)
    (address,) = messages
    return address


def test_links_stay_valid(tmp_path):
    known = tmp_path / "address.json"
    address = address_of(tmp_path, known)
    assert address_of(tmp_path, known) == address
    assert known.stat().st_mode & 0o077 == 0
    port = int(address.split(":")[2].split("/")[0])
    with socket.create_server(("127.0.0.1", port)):
        elsewhere = address_of(tmp_path, known)  # somebody else has the port now
    assert elsewhere.split("/")[3] == address.split("/")[3]
    assert elsewhere != address
    assert address_of(tmp_path).split("/")[3] != address.split("/")[3]


@pytest.mark.parametrize(
    "content", ["", '{"token": "", "port": 0}', '{"token": "abcdefghijklmnopqrst", "port": 70000}']
)
def test_a_damaged_address_is_replaced(content, tmp_path):
    (known := tmp_path / "address.json").write_text(content)
    known.chmod(0o600)
    assert address_of(tmp_path, known) == address_of(tmp_path, known)
    assert known.stat().st_mode & 0o077 == 0


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="needs owners of files")
def test_an_address_that_others_may_have_written_is_refused(tmp_path, monkeypatch):
    known = tmp_path / "studio" / "address.json"
    address_of(tmp_path / "studio", known)
    assert known.parent.stat().st_mode & 0o077 == 0
    for path, mode, usual in (known, 0o644, 0o600), (known.parent, 0o777, 0o700):
        path.chmod(mode)
        with pytest.raises(CadenzaError, match=f"^{path}: other users of this machine may"):
            serve(Studio(tmp_path / "studio").app, address_file=known)
        path.chmod(usual)
    known.rename(other := tmp_path / "other.json")
    known.symlink_to(other)
    with pytest.raises(CadenzaError, match=f"^{known}: other users"):
        serve(Studio(tmp_path / "studio").app, address_file=known)
    known.unlink()
    address_of(tmp_path / "studio", known)
    own = os.getuid()
    monkeypatch.setattr(os, "getuid", lambda: own + 1)
    with pytest.raises(CadenzaError, match="other users"):
        serve(Studio(tmp_path / "studio").app, address_file=known)


BROWSER = """#!{python}
import os, sys, urllib.parse
page = urllib.parse.urlsplit(sys.argv[-1])
about = os.stat(page.path), os.stat(os.path.dirname(page.path))
with open({told!r} + ".new", "w") as told:
    modes = [oct(each.st_mode & 0o777) for each in about]
    told.write("\\n".join([" ".join(sys.argv), page.path, *modes]))
    told.write("\\n" + open(page.path).read())
os.rename({told!r} + ".new", {told!r})
"""


@pytest.mark.parametrize(
    "end",
    [
        signal.SIGTERM,
        *(pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGINT, signal.SIGHUP)),
    ],
)
def test_the_token_is_in_no_list_of_processes(tmp_path, end):
    """A browser is opened by a file that only the user can read, and that is there for a while."""
    record, browser = tmp_path / "told", tmp_path / "browser"
    browser.write_text(BROWSER.format(python=sys.executable, told=str(record)))
    browser.chmod(0o700)
    command = [sys.executable, "-m", "cadenza", "studio", "--folder", str(tmp_path / "studio")]
    environment = os.environ | {"DISPLAY": ":0", "BROWSER": f"{browser} %s"}
    with subprocess.Popen(command, stdout=PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1]
        late = time.monotonic() + 20
        while not record.exists() and time.monotonic() < late:
            time.sleep(0.05)
        urlopen(address).close()  # it serves
        server.send_signal(end)
    arguments, page, mode, within, *content = record.read_text().splitlines()
    assert urlsplit(address).path.strip("/") not in arguments
    assert (mode, within) == ("0o600", "0o700")
    assert f"url={address}" in "".join(content)
    assert not Path(page).parent.exists()


WAITING = "import time; time.sleep(60)"  # a player that does nothing
SERVING = """
import sys
from contextlib import suppress
from pathlib import Path
from cadenza.studio.broadcast import Broadcast
from cadenza.studio.page_server import serve
from cadenza.studio.server import Studio

class Waiting(Studio):
    async def broadcast(self, id):
        return Broadcast("Waiting", {}) if id == "x" else None

with suppress(KeyboardInterrupt):
    serve(Waiting(Path(sys.argv[1])).app, ready=lambda address: print(address, flush=True))
"""


def frame(opcode: int, content: bytes, length: int | None = None, begin: int = 0x80) -> bytes:
    """A frame of a WebSocket, masked by zeros, with 64 bits for its length."""
    size = len(content) if length is None else length
    return struct.pack("!BBQI", begin | opcode, 0xFF, size, 0) + content


FRAMES = {
    "text that is none": frame(1, b"\xff\xff"),
    "text": frame(1, b"hello") * 1000,
    "long": frame(1, b"a" * 100_000),
    "longer than can be": frame(1, b"", 1 << 62),
    "of negative length": frame(2, b"", (1 << 64) - 1),
    "without end": frame(1, b"a" * 1000, begin=0) + frame(0, b"a" * 1000, begin=0) * 500,
    "unknown": frame(3, b"x") + frame(15, b"x"),
    "with reserved bits": frame(1, b"x", begin=0xF0),
    "two beginnings": frame(1, b"x", begin=0) * 2,
    "pings": frame(9, b"x") * 100 + frame(10, b"x"),
    "long ping": frame(9, b"x" * 200),
    "half a close": frame(8, b"x"),
    "closed why": frame(8, struct.pack("!H", 99) + b"\xff\xff"),
    "unmasked": b"\x81\x01x",
    "noise": bytes(range(256)) * 20,
}


def test_whatever_a_page_says_the_terminal_stays_empty_and_others_watch(tmp_path):
    command = [sys.executable, "-c", SERVING, str(tmp_path)]
    with subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True) as server:
        assert server.stdout is not None
        assert server.stderr is not None
        url = urlsplit(server.stdout.readline().strip())
        hello = (
            f"GET {url.path}watch/x HTTP/1.1\r\nhost: {url.netloc}\r\n"
            f"origin: http://{url.netloc}\r\nupgrade: websocket\r\nconnection: upgrade\r\n"
            "sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        ).encode()

        def watching() -> socket.socket:
            page = socket.create_connection(("127.0.0.1", url.port or 0), timeout=20)
            page.sendall(hello)
            received = b""
            while b"queued" not in received:
                received += (part := page.recv(4096))
                assert part, received
            return page

        with watching() as other:
            for content in FRAMES.values():
                with watching() as page, suppress(ConnectionError, TimeoutError):
                    page.sendall(content)
                    page.settimeout(0.1)
                    while page.recv(4096):
                        pass
            other.sendall(frame(9, b"there?"))
            assert b"there?" in other.recv(4096)
        server.send_signal(signal.SIGINT)
        assert server.stderr.read() == ""


def test_a_dropped_file_is_listed_once_read(client, tmp_path):
    path = tmp_path / "a.mid"
    notes, url = (Note(0, 1, 60), Note(1, 2, 62)), "/TOKEN/api/songs?name=%3Cb%3EMy%20song.mid"
    for title, shown in ("Sunrise Drive", "Sunrise Drive"), ("", "<b>My song"):
        write_midi(Score(notes, title=title), path)
        answer = client.post(url, content=path.read_bytes(), headers=SAME)
        assert answer.status_code == 201, answer.text
        (first, *_) = client.get("/TOKEN/api/songs").json()["songs"]
        assert (first["id"], first["title"], first["notes"]) == (answer.json()["id"], shown, 2)
        assert client.delete(f"/TOKEN/api/songs/{first['id']}", headers=SAME).status_code == 204
    assert not any(song["uploaded"] for song in client.get("/TOKEN/api/songs").json()["songs"])


def test_a_broken_or_large_file_gives_one_line_and_leaves_nothing(client, tmp_path):
    for content in b"MThd broken", b"\0" * (5 << 20):
        answer = client.post("/TOKEN/api/songs?name=a.mid", content=content, headers=SAME)
        assert answer.status_code == 400
        assert answer.json()["error"].startswith("a.mid")
        assert "\n" not in answer.json()["error"]
        assert str(tmp_path) not in answer.text
    assert list((tmp_path / "studio" / "uploads").iterdir()) == []


def test_a_file_that_was_read_before_is_not_lost_if_it_cannot_be_read_again(
    client, tmp_path, monkeypatch
):
    async def cannot(_: Path) -> Any:
        raise CadenzaError("it takes too long to read")

    write_midi(Score((Note(0.0, 1.0, 60),)), path := tmp_path / "a.mid")
    url = "/TOKEN/api/songs?name=a.mid"
    id = client.post(url, content=path.read_bytes(), headers=SAME).json()["id"]
    monkeypatch.setattr("cadenza.studio.server.read_upload", cannot)
    assert client.post(url, content=path.read_bytes(), headers=SAME).status_code == 400
    assert (tmp_path / "studio" / "uploads" / f"{id}.mid").read_bytes() == path.read_bytes()


def test_only_so_many_songs_wait(client):
    def ask(**request: Any) -> Any:
        return client.post("/TOKEN/api/jobs", json=request, headers=SAME)

    answers = [ask(song="OdeToJoy") for _ in range(jobs.MAX_QUEUED + 1)]
    assert [answer.status_code for answer in answers] == [201] * jobs.MAX_QUEUED + [400]
    assert "wait already" in answers[-1].json()["error"]
    id = answers[0].json()["id"]
    assert client.delete(f"/TOKEN/api/jobs/{id}", headers=SAME).status_code == 204
    with client.websocket_connect(f"ws://127.0.0.1:8000/TOKEN/watch/{id}", headers=SAME) as socket:
        assert socket.receive_json()["title"] == "Ode to Joy"
        assert socket.receive_json() == {"state": "cancelled"}
    assert ask(song="OdeToJoy").status_code == 201
    assert ask(song="../x").json()["error"].startswith("there is no such song")
    assert client.post("/TOKEN/api/jobs", content=b"{", headers=SAME).status_code == 400


async def player(script: str) -> Any:
    """A process that stands in for a player."""
    command = [sys.executable, "-S", "-c", script]
    return await asyncio.create_subprocess_exec(*command, stdin=PIPE, stdout=PIPE)


def asked(queue: jobs.JobQueue) -> jobs.Job:
    return queue.submit(PlayRequest("OdeToJoy"), "Ode", "OdeToJoy", False)


async def until(condition: Callable[[], Any]) -> None:
    while not condition():
        await asyncio.sleep(0.01)


async def cancelled(queue: jobs.JobQueue) -> Any:
    """The process of a job that is cancelled as soon as it has one."""
    job = asked(queue)
    await until(lambda: job.process is not None)
    process = job.process
    queue.cancel(job.id)
    await until(lambda: not job.is_busy)
    return process


Start = Callable[..., Awaitable[Any]]
Queue = Callable[[Start, Callable[[jobs.JobQueue], Awaitable[None]]], None]


@pytest.fixture
def queue(tmp_path, monkeypatch):
    """Use a queue whose players are started by a function."""

    def run_queue(start: Start, do: Callable[[jobs.JobQueue], Awaitable[None]]) -> None:
        async def run() -> None:
            queue = jobs.JobQueue(tmp_path)
            await do(queue)
            await queue.close()

        monkeypatch.setattr(jobs, "start_process", start)
        asyncio.run(asyncio.wait_for(run(), 60))

    return run_queue


def test_jobs_run_one_after_the_other_and_end_when_cancelled(queue):
    async def run(queue: jobs.JobQueue) -> None:
        first, second = asked(queue), asked(queue)
        assert (first.status["state"], second.status["state"]) == ("preparing", "queued")
        queue.cancel(first.id)  # before its process has even started
        await until(lambda: second.process is not None)
        assert (first.is_busy, first.status["state"]) == (False, "cancelled")
        second.process.kill()
        await until(lambda: second.is_over)
        assert second.status["error"] == "the player ended unexpectedly"

    queue(lambda *_: player(WAITING), run)


def test_a_song_plays_on_where_no_spare_player_can_start(queue):
    """The spare one is started when the song has been played, and its files are being written."""
    stream = io.BytesIO()
    json_message(state="played", verdict="").write(stream)
    json_message(state="kept", performance="x").write(stream)
    begun = []

    async def once(*_: str) -> Any:
        if begun:
            raise BlockingIOError(errno.EAGAIN, "no room for another process")
        begun.append(1)
        answer = f"sys.stdout.buffer.write({stream.getvalue()!r})"
        return await player(f"import sys; sys.stdin.readline(); {answer}")

    async def run(queue: jobs.JobQueue) -> None:
        job = asked(queue)
        await until(lambda: job.is_over and not job.is_busy)
        assert job.status["state"] == "kept"

    queue(once, run)


def test_a_player_whose_song_is_cancelled_plays_the_next(queue):
    """If it puts it down in time."""
    polite = (
        "import sys\nfor number, _ in enumerate(sys.stdin):\n"
        "    if number % 2:\n        sys.stdout.write('W\\0\\0\\0\\0')\n"
        "        sys.stdout.flush()"
    )
    programs = [polite, WAITING, WAITING]  # the last gets ready when the rude one has gone

    async def run(queue: jobs.JobQueue) -> None:
        first, second = await cancelled(queue), await cancelled(queue)
        assert first is second
        assert first.returncode is None
        first.kill()
        await first.wait()
        rude = await cancelled(queue)
        assert rude.returncode is not None

    queue(lambda *_: player(programs.pop(0)), run)


def test_what_is_cancelled_at_its_last_moment_is_not_kept(queue, tmp_path):
    """The player does not notice, and keeps it all the same."""
    keeping = (
        "import json, os\norder = json.loads(input())\ninput()\n"
        "os.mkdir(os.path.join(order['folder'], order['id']))"
    )

    async def run(queue: jobs.JobQueue) -> None:
        await cancelled(queue)
        assert list(tmp_path.iterdir()) == []

    queue(lambda *_: player(keeping), run)


def test_one_player_waits_at_most(queue):
    begun = []

    async def waiting(*_: str) -> Any:
        await asyncio.sleep(0.01)
        begun.append(await player(WAITING))
        return begun[-1]

    async def run(queue: jobs.JobQueue) -> None:
        await asyncio.gather(*(queue.start_player() for _ in range(3)))

    queue(waiting, run)
    assert len(begun) == 1


def test_a_file_that_does_not_come_is_given_up(client, monkeypatch):
    async def never(_: Any) -> AsyncIterator[bytes]:
        yield b"MThd"
        await asyncio.sleep(60)

    monkeypatch.setattr(Request, "stream", never)
    monkeypatch.setattr(server, "RECEIVE_TIME", 0.05)
    answer = client.post("/TOKEN/api/songs?name=a.mid", content=b"MThd", headers=SAME)
    assert answer.json()["error"] == "a.mid takes too long to come"


def test_a_page_that_closes_while_it_sends_is_no_fault_of_the_server(client, monkeypatch):
    async def gone(_: Any) -> AsyncIterator[bytes]:
        yield b"MThd"
        raise ClientDisconnect

    monkeypatch.setattr(Request, "stream", gone)
    answer = client.post("/TOKEN/api/songs?name=a.mid", content=b"MThd", headers=SAME)
    assert answer.json()["error"] == "a.mid has not come to its end"


def test_a_synthesizer_that_ends_is_started_again():
    async def run() -> None:
        synthesizer = Synthesizer()
        low = asyncio.create_task(synthesizer.tone(30, 0))
        await asyncio.sleep(0.01)
        low.cancel()  # its answer must not be that to the next question
        assert len(await synthesizer.tone(100, 0)) == 4 + 2 * (2 * 32_000 + 1)
        os.kill(await to_process.run_sync(os.getpid), signal.SIGKILL)
        with suppress(CadenzaError):
            await synthesizer.tone(100, 0)
        assert await synthesizer.tone(60, 3)

    asyncio.run(asyncio.wait_for(run(), 60))
