"""A page on which a performance of this process is watched, served by another process."""

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
from cadenza.performing.performance import Performance
from cadenza.performing.setup import Setup
from cadenza.studio.messages import WireMessage, json_message
from cadenza.studio.request import Order, PlayRequest
from cadenza.studio.state_stream import StateStream


class LivePage:
    """A page that is sent a performance while it is played."""

    def __init__(self, process: subprocess.Popen[bytes], setup: Setup) -> None:
        self._process = process
        self._states = StateStream(setup, self._send)
        self._states.begin()

    def reporting(self, progress: Progress) -> Progress:
        """Return `progress` that also informs the page."""

        def report(stage: str, done: int, total: int) -> None:
            if stage == "playing":
                self._states.step()
            else:
                self._send(json_message(state="preparing", stage=stage, done=done, total=total))
            progress(stage, done, total)

        return report

    def finish(self, performance: Performance) -> None:
        """Send the rest when all has been played."""
        self._states.finish(performance)

    def wait(self) -> None:
        """Keep the page open until Ctrl-C."""
        with suppress(KeyboardInterrupt):
            self._send(json_message(state="kept"))
            # With a timeout it looks now and then: else Ctrl-C just before it waits is not heeded.
            self._process.wait(math.inf)

    def _send(self, message: WireMessage) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # nobody can watch any more; the hands play on
            message.write(self._process.stdin)


@contextmanager
def open_page(setup: Setup) -> Iterator[LivePage]:
    """Yield the page, which is there until the block ends."""
    title = setup.score.title
    agent, hand = setup.settings["agent"], setup.settings["scene"]["hand"]
    arrangement = setup.settings["arrangement"]
    plain, expression = arrangement["plain"], bool(arrangement["expression"])
    request = PlayRequest(
        title, agent, hand=hand, seed=setup.seed, plain=plain, expression=expression
    )
    order = Order(request, title, title, False, secrets.token_hex(8), "")
    module = "cadenza.studio.live_page_server"
    command = [sys.executable, "-P", "-m", module, json.dumps(asdict(order))]
    # Ctrl-C is for this process, which plays.
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout is not None
    try:
        print(process.stdout.readline().decode(), end="", flush=True)  # before the song is over
        yield LivePage(process, setup)
    finally:
        process.terminate()
        process.wait()
