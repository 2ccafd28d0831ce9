"""Practises one song, as a process of its own: `python -m cadenza.studio.practice_process`.

It reads an order on stdin, as the process that plays does, and sends on stdout how far it has got:
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
from cadenza.files import parsed_json
from cadenza.performing.practising import Practising, practice_folder
from cadenza.performing.source import PRACTICE, PRACTISED
from cadenza.studio.limits import PLAYING, limit
from cadenza.studio.messages import Message, Send, json_message
from cadenza.studio.player import ProgressReporter, error_text, practice_folder_of, set_up_order
from cadenza.studio.request import Order

_NICENESS = 10  # nobody waits for practice
_REPORT_INTERVAL = 1.0  # [s] between two reports
_SAVE_INTERVAL = 20.0  # [s] at least between two times that practice is saved
_MAX_SAVING = 0.05  # share of the time that is spent on saving


def main() -> None:
    """Reads an order, and practises it until all practice has been made."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which kills this
    os.nice(_NICENESS)
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # what libraries print is no message
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
            send(json_message(state="failed", error=error_text(error, order)))


def practise(order: Order, send: Send) -> None:
    """Practises, and saves what is played better."""
    folder, report = practice_folder_of(order), ProgressReporter(send).report
    kept = practice_folder(folder)
    with kept.claimed() as ours, set_up_order(order, report) as setup:
        if not ours:
            raise CadenzaError("another studio practises this song already")
        try:
            practising = Practising(setup, kept, report)
        except CadenzaError:  # damaged
            if not (folder / PRACTICE).exists():
                raise
            (folder / PRACTICE).replace(folder / f"{PRACTICE}.old")
            practising = Practising(setup, kept, report)
        _Session(practising, folder, send).run()


class _Session:
    """Practises from where it was left until all practice has been made."""

    def __init__(self, practising: Practising, folder: Path, send: Send) -> None:
        self._practising, self._send = practising, send
        self._last_report, self._last_save, self._saving_time = 0.0, time.monotonic(), 0.0
        known = practising.practice.history if (folder / PRACTISED).exists() else ()
        self._num_saved = len(known)  # attempts

    def run(self) -> None:
        finished = False
        while not finished:
            finished = self._practising.practice.run(ENOUGH, self._continues)
            if self._has_more:
                self._save_attempt()
        self._report("done")

    @property
    def _has_more(self) -> bool:
        return len(self._practising.practice.history) > self._num_saved

    def _save_attempt(self) -> None:
        self._num_saved = len(self._practising.practice.history)
        self._practising.save()
        self._practising.save_plan()

    def _continues(self) -> bool:
        """Reports and saves now and then; returns whether there is no attempt to save."""
        now = time.monotonic()
        if now - self._last_report > _REPORT_INTERVAL:
            self._report("practising")
            self._last_report = now
        if now - self._last_save > max(_SAVE_INTERVAL, self._saving_time / _MAX_SAVING):
            self._practising.save()
            self._last_save = time.monotonic()
            self._saving_time = self._last_save - now
        return not self._has_more

    def _report(self, state: str) -> None:
        practice = self._practising.practice
        f1, onsets = ([row[i] for row in practice.history] for i in (1, 2))
        share = practice.share_made(ENOUGH)
        self._send(json_message(state=state, f1=f1, note_onset_f1=onsets, share=share))


if __name__ == "__main__":
    main()
