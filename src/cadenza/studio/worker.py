"""Plays one song, as a process of its own: `python -m cadenza.studio.worker`.

It loads all that is needed and warms up, then waits for an order (see
`cadenza.studio.request.Order`) as a line of JSON on stdin, and tells on stdout what happens, as
`cadenza.studio.messages` has it. While it plays, it can be told to wait and go on, or to put the
song down and wait for the next order; a song that is played to its end is its last.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
import warnings
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from select import POLLIN, poll
from typing import IO, Any

from cadenza.agents.agent import Progress
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.planner import Planner  # loaded before it is needed
from cadenza.agents.registry import PLANNER
from cadenza.errors import CadenzaError
from cadenza.files import parsed_json, plain, write_json
from cadenza.music.arrangement import Arrangement
from cadenza.music.score import Note, Score
from cadenza.performing.performance import Performance, perform
from cadenza.performing.setup import Selection, Setup, select, set_up
from cadenza.performing.source import PRACTISED as PLAN
from cadenza.studio.limits import PLAYING, limit
from cadenza.studio.live import Live, Send, as_json
from cadenza.studio.messages import GO_ON, READY, WAIT, Message
from cadenza.studio.reading import check_size, without_path
from cadenza.studio.request import (
    PRACTISED,
    ROWS,
    SIGHT,
    TOLD,
    Order,
    performance_folder,
    practice_folder,
)

__all__ = ["Planner", "main"]

_MOST_PUT_DOWN = 32  # songs, of each of which a few MB stay behind, before the process ends
_LESS = 4  # priority
_BETWEEN = 0.2  # [s] between two times that a stage is told


def main() -> None:
    """See above."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which kills this
    os.nice(_LESS)  # than the browser beside it, which draws pictures and makes sound
    with os.fdopen(os.dup(1), "wb") as out, open(0, "rb", buffering=0) as orders:
        os.dup2(2, 1)  # what others print is no message
        warm_up()
        put_down = 0
        while line := orders.readline():
            limit(PLAYING)
            try:
                perform_order(parsed_json(line, Order, "order"), orders, out)
                break
            except PutDown:
                put_down += 1
                if put_down == _MOST_PUT_DOWN:
                    break
                with suppress(BrokenPipeError):  # the server has gone, and so do its orders
                    Message(READY, b"").write(out)


class PutDown(BaseException):
    """The server wants the song no more. No fault of whoever plays, where it is raised."""


def perform_order(order: Order, orders: IO[bytes], out: IO[bytes]) -> None:
    """Plays what is asked for, and keeps it.

    Raises:
        PutDown: it has not been played yet, and `orders` say so, or are at their end.
    """

    def send(message: Message) -> None:
        try:
            message.write(out)
        except BrokenPipeError:  # nobody listens: the server has gone
            if not keeping:
                os._exit(1)

    more = poll()
    more.register(orders, POLLIN)

    def check() -> None:
        if more.poll(0) and not (orders.readline() == WAIT and orders.readline() == GO_ON):
            raise PutDown

    keeping = False
    try:
        performance, live = play(order, send, check)
        keeping = True
        keep(performance, live, order, send)
    except (CadenzaError, OSError) as error:
        send(as_json(state="failed", error=what_failed(error, order)))
    except MemoryError:
        send(as_json(state="failed", error="it needs more memory than a player may use"))


def what_failed(error: BaseException, order: Order) -> str:
    """As the page says it."""
    return without_path(error, Path(order.source) if order.uploaded else None)


def warm_up() -> None:
    """Takes a step, so that what a first step loads and computes is there for the next."""
    with set_up(select(Score((Note(0.0, 0.1, 60),)), PLANNER)) as setup:
        perform(setup, stop=lambda: True)


def play(order: Order, send: Send, check: Callable[[], None]) -> tuple[Performance, Live]:
    """Plays, telling every step, and calling `check` now and then; also what was told."""
    began = time.monotonic()
    told = Told(send)

    def preparing(stage: str, done: int, total: int) -> None:
        check()
        told.stage(stage, done, total)

    with _as_practised(order) or set_up_as_asked(order, preparing) as setup:
        live = Live(setup.task, send)
        live.begin()

        def progress(stage: str, done: int, total: int) -> None:
            if stage != "playing":
                preparing(stage, done, total)
                return
            check()
            live.step()

        performance = perform(setup, progress)
        spent = round(time.monotonic() - began, 3)
        metrics = plain(performance.metrics)
        remarks = performance.remarks
        send(as_json(state="played", metrics=metrics, spent=spent, remarks=remarks))
        return performance, live


def set_up_as_asked(order: Order, tell: Progress) -> AbstractContextManager[Setup]:
    """The song, whoever plays it, and how."""
    request, selection = order.request, _selected(order)
    task, scene = selection.task, selection.scene
    if selection.learnt is None:
        scene = replace(scene, hand=request.hand)
    transpose, stretch = task.transpose + request.transpose, task.stretch / request.tempo
    task = replace(task, transpose=transpose, stretch=stretch)
    return set_up(selection, task, scene, request.seed, tell)


def _as_practised(order: Order) -> AbstractContextManager[Setup] | None:
    """What has been practised, where that is wanted and there is any."""
    if order.request.agent != PRACTISED:
        return None
    folder = practised_in(order)
    if not (folder / PLAN).exists():
        return None
    try:
        selection = select(str(folder))
    except CadenzaError:  # of another version, or damaged: practice makes another
        (folder / PLAN).replace(folder / f"{PLAN}.old")
        return None
    return set_up(selection, seed=order.request.seed)


def practised_in(order: Order) -> Path:
    """The folder where what is asked for is practised."""
    return practice_folder(Path(order.folder), order.request, _selected(order).score)


def _selected(order: Order) -> Selection:
    """The song and who plays it, called as the visitor calls it."""
    request, agent = order.request, order.agent
    config = {PLANNER: PlannerConfig(method="none")} if request.agent == SIGHT else None
    arrangement = Arrangement(tracks=request.tracks)
    song = _score(order, arrangement) if order.uploaded else order.source
    selection = select(song, agent, arrangement=arrangement, configs=config)
    check_size(selection.score)
    return selection


def _score(order: Order, arrangement: Arrangement) -> Score:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        score = arrangement.score(order.source)
    return replace(score, title=order.title)


def keep(performance: Performance, live: Live, order: Order, send: Send) -> None:
    """Writes what `cadenza play` leaves, and what was told, to be told again.

    The folder appears when all of it is there.
    """
    root, told = Path(order.folder), Told(send, "writing")
    folder = performance_folder(root, order.id)
    about: dict[str, Any] = {
        "title": order.title,
        "request": asdict(order.request),
        "f1": performance.metrics["f1"],
        "note_onset_f1": performance.metrics["note_onset_f1"],
        "seconds": performance.seconds,
        "remarks": performance.remarks,
        "finished": time.time(),
    }
    try:
        performance.save(folder, order.video, told.stage)
        (folder / TOLD).write_bytes(live.about)
        (folder / ROWS).write_bytes(live.rows)
        write_json(folder / "studio.json", about)
        folder.rename(root / order.id)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    send(as_json(state="kept", performance=order.id))


class Told:
    """Tells how far a stage is, not too often."""

    def __init__(self, send: Send, state: str = "preparing") -> None:
        self._send, self._state = send, state
        self._last = ("", 0.0)

    def stage(self, stage: str, done: int, total: int) -> None:
        now = time.monotonic()
        if stage == self._last[0] and now - self._last[1] < _BETWEEN:
            return
        self._last = stage, now
        self._send(as_json(state=self._state, stage=stage, done=done, total=total))


if __name__ == "__main__":
    main()
