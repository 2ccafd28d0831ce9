"""Practice of one song, as a process of its own: `python -m cadenza.studio.practice_process`.

It reads an order on stdin, as the process that plays does, and sends its progress on stdout:
`state` practising, done or failed, `f1` and `note_onset_f1` at first sight and of the best after
every attempt at the song, and the `share` of all practice that has been made. Its folder has the
best plan so far.
"""

import os
import sys

from cadenza.agents.planner.config import ENOUGH
from cadenza.agents.registry import PRACTISED
from cadenza.errors import CadenzaError
from cadenza.files import parsed_json
from cadenza.performing.practising import Practising, practice_folder
from cadenza.performing.setup import PRACTICE
from cadenza.resumable import RateLimited
from cadenza.studio.limits import PLAYING, limit
from cadenza.studio.messages import Send, WireMessage, json_message
from cadenza.studio.player import (
    error_text,
    messages_of,
    practice_folder_of,
    progress_reporter,
    set_up_order,
)
from cadenza.studio.request import Order

_NICENESS = 10  # practice is not urgent
_REPORT_INTERVAL = 1.0  # [s] between two reports


def main() -> None:
    """Read an order, and practise it until all practice has been made."""
    with messages_of(_NICENESS) as out:
        limit(PLAYING)
        order = parsed_json(sys.stdin.buffer.readline(), Order, "order")

        def send(message: WireMessage) -> None:
            try:
                message.write(out)
            except BrokenPipeError:  # the server has gone
                os._exit(1)

        try:
            practise(order, send)
        except (CadenzaError, OSError) as error:
            send(json_message(state="failed", error=error_text(error, order)))


def practise(order: Order, send: Send) -> None:
    """Practise, and save better plans."""
    folder, report = practice_folder_of(order), progress_reporter(send)
    practice = practice_folder(folder)
    with practice.claimed() as is_claimed, set_up_order(order, report) as setup:
        if not is_claimed:
            raise CadenzaError("another studio practises this song already")
        try:
            practising = Practising(setup, practice, report)
        except CadenzaError:  # damaged
            if not (folder / PRACTICE).exists():
                raise
            (folder / PRACTICE).replace(folder / f"{PRACTICE}.old")
            practising = Practising(setup, practice, report)
        history = practising.practice.history if (folder / PRACTISED).exists() else ()
        _practise_until_done(practising, len(history), send)


def _practise_until_done(practising: Practising, num_saved: int, send: Send) -> None:
    """Practise until all practice has been made; report and save now and then.

    `num_saved` attempts had been made before the plan was saved.
    """
    practice, finished = practising.practice, False

    def report(state: str) -> None:
        f1, onsets = ([row[i] for row in practice.history] for i in (1, 2))
        share = practice.share_made(ENOUGH)
        send(json_message(state=state, f1=f1, note_onset_f1=onsets, share=share))

    report_if_due = RateLimited(lambda: report("practising"), _REPORT_INTERVAL, share=1.0)

    def should_continue() -> bool:
        report_if_due()
        practising.save_if_due()
        return len(practice.history) == num_saved

    while not finished:
        finished = practice.run(ENOUGH, should_continue)
        if len(practice.history) > num_saved:
            num_saved = len(practice.history)
            practising.save()
            practising.save_plan()
    report("done")


if __name__ == "__main__":
    main()
