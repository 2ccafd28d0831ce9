"""The process that plays."""

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from subprocess import PIPE, Popen
from typing import IO

import pytest

from cadenza.music.formats.midi import write_midi
from cadenza.music.score import Note, Score
from cadenza.studio.messages import HEADER, IDLE, JSON, ROWS
from cadenza.studio.request import Order, PlayRequest

pytestmark = pytest.mark.slow


def message(stream: IO[bytes]) -> tuple[bytes, bytes]:
    kind, length = HEADER.unpack(stream.read(HEADER.size))
    return kind, stream.read(length)


Say = Callable[[bytes], None]
Hear = Callable[[], tuple[bytes, bytes]]


@contextmanager
def player() -> Iterator[tuple[Say, Hear]]:
    """A worker that ends well: tells it a line, and says what it tells."""
    command = [sys.executable, "-P", "-m", "cadenza.studio.player"]
    with Popen(command, stdin=PIPE, stdout=PIPE) as worker:
        assert worker.stdin is not None
        assert worker.stdout is not None
        orders, answers = worker.stdin, worker.stdout

        def say(line: bytes) -> None:
            orders.write(line + b"\n")
            orders.flush()

        yield say, lambda: message(answers)
        orders.close()
        assert worker.wait(60) == 0


def ode_to_joy(folder: Path) -> bytes:
    order = Order(PlayRequest("OdeToJoy"), "", "OdeToJoy", False, "0" * 16, str(folder))
    return json.dumps(asdict(order)).encode()


def test_a_song_is_put_down_while_it_is_planned(tmp_path):
    """The same process then waits for another."""
    with player() as (say, hear):
        say(ode_to_joy(tmp_path))
        messages = [hear()]
        while b"postures" not in messages[-1][1]:
            messages.append(hear())
        say(b"")
        while messages[-1][0] != IDLE:
            messages.append(hear())
        assert not any(b"failed" in content for kind, content in messages if kind == JSON)


def test_what_is_not_played_is_told(tmp_path):
    trill = tuple(Note(0.08 * i, 0.08 * i + 0.02, 60) for i in range(10))
    write_midi(Score(trill), tmp_path / "trill.mid")
    request, source = PlayRequest("trill"), str(tmp_path / "trill.mid")
    order = Order(request, "Trill", source, True, "0" * 16, str(tmp_path / "out"))
    with player() as (say, hear):
        say(json.dumps(asdict(order)).encode())
        messages = [hear()]
        while b"kept" not in messages[-1][1]:
            messages.append(hear())
    (played,) = [json.loads(c) for kind, c in messages if kind == JSON and b'"played"' in c]
    (remark,) = played["remarks"]
    assert remark.startswith("4 notes repeat too fast for control steps of 0.05 s")


def test_a_song_that_was_put_down_is_played_again_just_the_same(tmp_path):
    with player() as (say, hear):
        played: list[list[bytes]] = []
        for _ in range(2):
            say(ode_to_joy(tmp_path))
            rows: list[bytes] = []
            while len(rows) < 20:
                kind, content = hear()
                rows += [content] * (kind == ROWS)
            played.append(rows)
            say(b"")
            while hear()[0] != IDLE:
                pass
        assert played[0] == played[1]
    assert not list(tmp_path.iterdir())
