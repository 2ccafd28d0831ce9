"""Has a performance of this process watched on a page, which another process serves."""

from __future__ import annotations

import json
import math
import secrets
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict

from cadenza.agents.agent import Progress
from cadenza.files import plain
from cadenza.performing.performance import Performance
from cadenza.performing.setup import Setup
from cadenza.studio.live import Live, as_json
from cadenza.studio.messages import Message
from cadenza.studio.request import Order, PlayRequest


class Showing:
    """A performance that is told to the page as it goes."""

    def __init__(self, process: subprocess.Popen[bytes], setup: Setup) -> None:
        self._process = process
        self._live = Live(setup.task, self._send)
        self._live.begin()

    def following(self, progress: Progress) -> Progress:
        """`progress` that also tells the page."""

        def tell(stage: str, done: int, total: int) -> None:
            if stage == "playing":
                self._live.step()
            else:
                self._send(as_json(state="preparing", stage=stage, done=done, total=total))
            progress(stage, done, total)

        return tell

    def played(self, performance: Performance) -> None:
        """Tells the end."""
        metrics = plain(performance.metrics)
        self._send(as_json(state="played", metrics=metrics, remarks=performance.remarks))

    def stay(self) -> None:
        """Until Ctrl-C."""
        with suppress(KeyboardInterrupt):
            self._send(as_json(state="kept", performance=""))
            # With a timeout it looks now and then: else Ctrl-C just before it waits is not heeded.
            self._process.wait(math.inf)

    def _send(self, message: Message) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # nobody can watch any more; the hands play on
            message.write(self._process.stdin)


@contextmanager
def shown(setup: Setup, title: str) -> Iterator[Showing]:
    """The page is there until the block ends."""
    agent, hand = setup.settings["agent"], setup.settings["scene"]["hand"]
    request = PlayRequest(title, agent, hand=hand, seed=setup.seed)
    order = Order(request, title, title, False, secrets.token_hex(8), "")
    module = "cadenza.studio.watching"
    command = [sys.executable, "-P", "-m", module, json.dumps(asdict(order))]
    # Ctrl-C is for whoever plays.
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout is not None
    try:
        print(process.stdout.readline().decode(), end="", flush=True)  # before the song is over
        yield Showing(process, setup)
    finally:
        process.terminate()
        process.wait()
