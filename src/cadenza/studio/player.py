"""Player of one song, as a process of its own: `python -m cadenza.studio.player`.

It loads its modules and warms up, then waits for an order (see `cadenza.studio.request.Order`) as a
line of JSON on stdin, and sends messages on stdout (see `cadenza.studio.messages`). While it plays,
the server can cancel the song, and it waits for the next order. It ends after a complete song.
"""

import os
import shutil
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from select import POLLIN, poll
from typing import IO

from cadenza.agents.agent import Progress
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.registry import PLANNER, PLAYBACK
from cadenza.agents.registry import PRACTISED as PLAN
from cadenza.errors import CadenzaError
from cadenza.files import parsed_json, write_json
from cadenza.music.arrangement import LoadedSong, load
from cadenza.music.score import Note, Score
from cadenza.performing.performance import Performance, perform
from cadenza.performing.setup import Setup, find_player, set_up
from cadenza.studio.limits import PLAYING, limit
from cadenza.studio.messages import IDLE, Send, WireMessage, json_message
from cadenza.studio.request import (
    HEADER_FILE,
    PLANNER_VARIANTS,
    PRACTISED,
    ROWS_FILE,
    UNREFINED,
    Order,
    practice_folder,
    unfinished_folder,
)
from cadenza.studio.state_stream import StateStream, words_of
from cadenza.studio.storage import ABOUT, KeptPerformance
from cadenza.studio.upload_reader import check_size, error_without_path

_MAX_DROPPED = 32  # songs before the process ends, as a few MB of each stay behind
_NICENESS = 4  # leaves the browser beside it time to draw pictures and make sound
_REPORT_INTERVAL = 0.2  # [s] between two reports on a stage


def main() -> None:
    """Wait for orders, and play until a song is at its end."""
    with messages_of(_NICENESS) as out, open(0, "rb", buffering=0) as orders:
        warm_up()
        dropped = 0
        while line := orders.readline():
            limit(PLAYING)
            try:
                play_order(parsed_json(line, Order, "order"), orders, out)
                break
            except Cancelled:
                dropped += 1
                if dropped == _MAX_DROPPED:
                    break
                with suppress(BrokenPipeError):  # the server has gone, and so do its orders
                    WireMessage(IDLE, b"").write(out)


@contextmanager
def messages_of(niceness: int) -> Iterator[IO[bytes]]:
    """Make this a process of the server's; yield the stream of its messages."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server, which kills this
    os.nice(niceness)
    with os.fdopen(os.dup(1), "wb") as out:
        os.dup2(2, 1)  # what libraries print is no message
        yield out


class Cancelled(BaseException):
    """The server has cancelled the song; no error of the agent in which it is raised."""


def play_order(order: Order, orders: IO[bytes], out: IO[bytes]) -> None:
    """Play the song of an order, and keep the performance.

    Raises Cancelled if there is a line in `orders`, or their end, before the song ends.
    """

    def send(message: WireMessage) -> None:
        try:
            message.write(out)
        except BrokenPipeError:  # the server has gone
            if not is_saving:
                os._exit(1)

    lines = poll()
    lines.register(orders, POLLIN)

    def check() -> None:
        if lines.poll(0):
            orders.readline()
            raise Cancelled

    is_saving = False
    try:
        performance, states = play(order, send, check)
        is_saving = True
        save(performance, states, order, send)
    except (CadenzaError, OSError) as error:
        send(json_message(state="failed", error=error_text(error, order)))
    except MemoryError:
        send(json_message(state="failed", error="it needs more memory than a player may use"))


def error_text(error: BaseException, order: Order) -> str:
    """An error as the page shows it."""
    return error_without_path(error, Path(order.source) if order.uploaded else None)


def warm_up() -> None:
    """Take a step, as the first one loads and computes much."""
    with set_up(Score((Note(0.0, 0.1, 60),)), find_player(PLANNER)) as setup:
        perform(setup, stop=lambda: True)


def play(order: Order, send: Send, check: Callable[[], None]) -> tuple[Performance, StateStream]:
    """Play a song and send each step, calling `check` now and then; returns the sent states too."""
    report = progress_reporter(send)

    def prepare(stage: str, done: int, total: int) -> None:
        check()
        report(stage, done, total)

    with _practised_setup(order) or set_up_order(order, prepare) as setup:
        states = StateStream(setup, send)
        states.begin()

        def progress(stage: str, done: int, total: int) -> None:
            if stage != "playing":
                prepare(stage, done, total)
                return
            check()
            states.step()

        performance = perform(setup, progress)
        states.finish(performance)
        return performance, states


def set_up_order(order: Order, progress: Progress) -> AbstractContextManager[Setup]:
    """Set up the song, the agent and the hands that an order asks for."""
    request, song = order.request, _song(order)
    agent = PLANNER if request.agent in PLANNER_VARIANTS else request.agent
    configs = {PLANNER: PlannerConfig(method="none")} if request.agent == UNREFINED else None
    player = find_player(agent, song.name, configs=configs)
    task, scene = player.task, player.scene
    if player.policy is None:
        scene = replace(scene, hand=request.hand, hands=request.playing_hands)
    transpose, stretch = task.transpose + request.transpose, task.stretch / request.tempo
    as_written = request.hands == "written"
    task = replace(task, transpose=transpose, stretch=stretch, hands_as_written=as_written)
    player = player.playing_in(task, scene)
    return set_up(song, player, seed=request.seed, progress=progress)


def _practised_setup(order: Order) -> AbstractContextManager[Setup] | None:
    """Set up the practised plan of a song, if the order asks for it and there is one."""
    if order.request.agent != PRACTISED:
        return None
    folder = practice_folder_of(order)
    if not (folder / PLAN).exists():
        return None
    try:
        player = find_player(folder)
    except CadenzaError:  # damaged: practice makes another
        (folder / PLAN).replace(folder / f"{PLAN}.old")
        return None
    # Its folder is the studio's own, and no name to be shown.
    return set_up(None, replace(player, name=PLAYBACK), seed=order.request.seed)


def practice_folder_of(order: Order) -> Path:
    """The folder in which an order is practised."""
    return practice_folder(Path(order.folder), order.request, _song(order).score)


def _song(order: Order) -> LoadedSong:
    """Load the song of an order; raises CadenzaError if there is nothing, or too much, to play."""
    with warnings.catch_warnings():
        if order.uploaded:
            warnings.simplefilter("ignore")
        song = load(order.source, order.request.arrangement)
    check_size(song.score)
    return song.titled(order.title) if order.uploaded else song


def save(performance: Performance, states: StateStream, order: Order, send: Send) -> None:
    """Write the files of `cadenza play` and the sent messages; the folder appears at the end."""
    root = Path(order.folder)
    folder = unfinished_folder(root, order.id)
    summary = KeptPerformance(
        title=order.title,
        request=order.request,
        verdict=words_of(performance),
        seconds=performance.seconds,
        finished=time.time(),
        remarks=performance.remarks,
    )
    try:
        performance.save(folder, progress_reporter(send, "writing"))
        (folder / HEADER_FILE).write_bytes(json_message(**states.header).content)
        (folder / ROWS_FILE).write_bytes(states.rows)
        write_json(folder / ABOUT, asdict(summary))
        folder.rename(root / order.id)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    send(json_message(state="kept"))


def progress_reporter(send: Send, state: str = "preparing") -> Progress:
    """A function that reports the progress of a stage, unless its last report is recent."""
    last_stage, last_time = "", 0.0

    def report(stage: str, done: int, total: int) -> None:
        nonlocal last_stage, last_time
        now = time.monotonic()
        if stage != last_stage or now - last_time >= _REPORT_INTERVAL:
            last_stage, last_time = stage, now
            send(json_message(state=state, stage=stage, done=done, total=total))

    return report


if __name__ == "__main__":
    main()
