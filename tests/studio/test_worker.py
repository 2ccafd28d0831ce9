"""The process that plays."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from subprocess import PIPE, Popen
from typing import IO

import pytest

from cadenza.studio.messages import HEADER, JSON, READY, ROWS
from cadenza.studio.request import Order, PlayRequest

pytestmark = pytest.mark.slow


def message(stream: IO[bytes]) -> tuple[bytes, bytes]:
    kind, length = HEADER.unpack(stream.read(HEADER.size))
    return kind, stream.read(length)


def test_a_song_is_put_down_while_it_is_planned(tmp_path: Path) -> None:
    """By the same process, which then waits for another."""
    order = Order(PlayRequest("OdeToJoy"), "", "OdeToJoy", False, "0" * 16, str(tmp_path), False)
    command = [sys.executable, "-P", "-m", "cadenza.studio.worker"]
    with Popen(command, stdin=PIPE, stdout=PIPE) as worker:
        assert worker.stdin is not None
        assert worker.stdout is not None
        worker.stdin.write(json.dumps(asdict(order)).encode() + b"\n")
        worker.stdin.flush()
        told = [message(worker.stdout)]
        while b"postures" not in told[-1][1]:
            told.append(message(worker.stdout))
        worker.stdin.write(b"\n")
        worker.stdin.flush()
        while told[-1][0] != READY:
            told.append(message(worker.stdout))
        assert not any(b"failed" in content for kind, content in told if kind == JSON)
        worker.stdin.close()
        assert worker.wait(60) == 0


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
