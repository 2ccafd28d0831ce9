"""Practises one song, as a process of its own: `python -m cadenza.studio.practising`.

It is told what on stdin, as the process that plays is, and tells on stdout how far it has got:
`state` practising, done or failed, `f1` and `note_onset_f1` at first sight and of the best after
every attempt at all of the song, and what `share` of all practice has been made. Whenever the song
is played better, its folder has the plan for it.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

from cadenza.agents.planner.config import ENOUGH
from cadenza.errors import CadenzaError
from cadenza.files import TEMPORARY, locked, parsed_json
from cadenza.performing.practising import Practising
from cadenza.performing.source import PRACTICE, PRACTISED
from cadenza.studio.limits import PLAYING, limit
from cadenza.studio.live import Send, as_json
from cadenza.studio.messages import Message
from cadenza.studio.request import Order
from cadenza.studio.worker import Told, practised_in, set_up_as_asked, what_failed

_TOLD = 1.0  # [s] between two times that it tells how far it is
_SAVED = 20.0  # [s] at least between two times that practice is kept


def main() -> None:
    """See above."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which kills this
    os.nice(10)
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # what others print is no message
        limit(PLAYING)
        order = parsed_json(sys.stdin.buffer.readline(), Order, "order")

        def send(message: Message) -> None:
            try:
                message.write(out)
            except BrokenPipeError:  # the server has gone
                os._exit(1)

        try:
            practise(order, send)
        except (CadenzaError, OSError) as error:
            send(as_json(state="failed", error=what_failed(error, order)))


def practise(order: Order, send: Send) -> None:
    """Practises, and keeps what is better."""
    folder, tell = practised_in(order), Told(send).stage
    with locked(folder) as ours, set_up_as_asked(order, tell) as setup:
        if not ours:
            raise CadenzaError("another studio practises this song already")
        for left in folder.glob(f"{TEMPORARY}*"):  # by a process that was killed
            left.unlink(missing_ok=True)
        try:
            practising = Practising(setup, folder, tell)
        except CadenzaError:  # of another version, or damaged
            if not (folder / PRACTICE).exists():
                raise
            (folder / PRACTICE).replace(folder / f"{PRACTICE}.old")
            practising = Practising(setup, folder, tell)
        _Session(practising, folder, send).run()


class _Session:
    """Practice from where it was left until all of it has been made."""

    def __init__(self, practising: Practising, folder: Path, send: Send) -> None:
        self._practising, self._send = practising, send
        self._told, self._saved, self._saving = 0.0, time.monotonic(), 0.0
        known = practising.practice.history if (folder / PRACTISED).exists() else ()
        self._kept = len(known)  # attempts

    def run(self) -> None:
        finished = False
        while not finished:
            finished = self._practising.practice.run(ENOUGH, self._goes_on)
            if self._has_more:
                self._keep()
        self._tell("done")

    @property
    def _has_more(self) -> bool:
        return len(self._practising.practice.history) > self._kept

    def _keep(self) -> None:
        self._kept = len(self._practising.practice.history)
        self._practising.save()
        self._practising.save_plan()

    def _goes_on(self) -> bool:
        """Asked often."""
        now = time.monotonic()
        if now - self._told > _TOLD:
            self._tell("practising")
            self._told = now
        if now - self._saved > max(_SAVED, 20 * self._saving):
            self._practising.save()
            self._saved = time.monotonic()
            self._saving = self._saved - now
        return not self._has_more

    def _tell(self, state: str) -> None:
        practice = self._practising.practice
        f1, onsets = ([row[i] for row in practice.history] for i in (1, 2))
        share = practice.share_made(ENOUGH)
        self._send(as_json(state=state, f1=f1, note_onset_f1=onsets, share=share))


if __name__ == "__main__":
    main()
