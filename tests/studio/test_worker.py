"""The process that plays."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from subprocess import PIPE, Popen
from typing import IO

import pytest

from cadenza.studio.messages import HEADER, READY, ROWS
from cadenza.studio.request import Order, PlayRequest

pytestmark = pytest.mark.slow


def message(stream: IO[bytes]) -> tuple[bytes, bytes]:
    kind, length = HEADER.unpack(stream.read(HEADER.size))
    return kind, stream.read(length)


def test_a_song_that_was_put_down_is_played_again_just_the_same(tmp_path: Path) -> None:
    order = Order(PlayRequest("OdeToJoy"), "", "OdeToJoy", False, "0" * 16, str(tmp_path), False)
    command = [sys.executable, "-P", "-m", "cadenza.studio.worker"]
    with Popen(command, stdin=PIPE, stdout=PIPE) as worker:
        assert worker.stdin is not None
        assert worker.stdout is not None
        played: list[list[bytes]] = []
        for _ in range(2):
            worker.stdin.write(json.dumps(asdict(order)).encode() + b"\n")
            worker.stdin.flush()
            rows: list[bytes] = []
            while len(rows) < 20:
                kind, content = message(worker.stdout)
                rows += [content] * (kind == ROWS)
            played.append(rows)
            worker.stdin.write(b"\n")
            worker.stdin.flush()
            while message(worker.stdout)[0] != READY:
                pass
        assert played[0] == played[1]
        worker.stdin.close()
        assert worker.wait(60) == 0
    assert not list(tmp_path.iterdir())
