"""The search of one hand in a process of its own, while the parent process searches for another.

`python -m cadenza.agents.planner.search.hand_process` is that process. It receives pickled calls of
the methods of a `RestartingSearch` on stdin, and answers on stdout. It finds a few windows before
they are requested. The result is the same to the bit as in one process.
"""

import os
import pickle
import signal
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np

from cadenza.agents.agent import Array
from cadenza.agents.planner.config import PlannerConfig
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.hand_search import HandSearch, PlayedStep
from cadenza.agents.planner.search.search_ahead import HandState, RestartingSearch
from cadenza.errors import CadenzaError
from cadenza.fingers import Side

_AHEAD = 2  # windows that are found before they are requested
_LOST = (
    "the process that searches for the {side} hand ended unexpectedly: is there enough memory? "
    "--num-threads 1 does without it"
)


class HandProcess:
    """A `WindowSearch` in another process, which ends with this object."""

    def __init__(self) -> None:
        """Start the process. Raises OSError if there is no memory for it."""
        module = "cadenza.agents.planner.search.hand_process"
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},  # modules of hands, too
        )
        weakref.finalize(self, _end, self._process)
        self._num_begins, self._side = 0, "other"

    def search(
        self, plan: SongPlan, side: Side, rng: np.random.Generator, config: PlannerConfig
    ) -> None:
        """Prepare to search for the hand on one side; see `HandSearch`."""
        self._side = side
        try:
            self._call(plan, side, rng, config)
        except (CadenzaError, pickle.PicklingError, AttributeError, TypeError):
            self._process.kill()  # the plan cannot be pickled

    def is_ready(self) -> bool:
        """Whether it can search: not for a hand that only the parent process has registered."""
        with suppress(CadenzaError):
            return bool(self._answer())
        return False

    def follow(self, plan: SongPlan, step: int) -> None:
        self._call("follow", plan, step)

    def act(self, state: HandState) -> Array:
        self._call("act", state)
        while isinstance(answer := self._answer(), tuple):
            pass  # a window that is now obsolete
        return np.asarray(answer)

    def begin(self, state: HandState) -> None:
        self._num_begins += 1
        self._call("begin", state)

    def next_window(self) -> list[PlayedStep]:
        self._call("next_window")
        while True:
            num_begins, window = self._answer()
            if num_begins == self._num_begins:
                return list[PlayedStep](window)

    def _call(self, *message: Any) -> None:
        assert self._process.stdin is not None
        pickled = pickle.dumps(message)
        try:
            self._process.stdin.write(pickled)
            self._process.stdin.flush()
        except OSError:
            raise CadenzaError(_LOST.format(side=self._side)) from None

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        try:
            return pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):  # before an answer, or within it
            raise CadenzaError(_LOST.format(side=self._side)) from None


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Kill the process, and wait for it, so that its CPU time counts as that of a child."""
    process.kill()
    for pipe in process.stdin, process.stdout:
        assert pipe is not None
        with suppress(OSError):  # unsent calls do not matter
            pipe.close()
    process.wait()


def main() -> None:
    """Search for a hand until the parent process closes stdin."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends this one
    calls = SimpleQueue[Any]()
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # output of libraries is no answer
        threading.Thread(target=_receive, args=(calls,), daemon=True).start()

        def answer(value: Any) -> None:
            pickle.dump(value, answers)
            answers.flush()

        _serve(calls, answer)


def _receive(calls: SimpleQueue[Any]) -> None:
    """Receive calls, even while one is carried out, and end the process at the end of stdin.

    It also ends the process at a call that it cannot unpickle, such as one with a hand that only
    the parent process has registered.
    """
    with suppress(Exception):
        while True:
            calls.put(pickle.load(sys.stdin.buffer))
    os._exit(0)


def _serve(calls: SimpleQueue[Any], answer: Callable[[Any], None]) -> None:
    """Carry out calls, and find windows ahead between them."""
    plan, side, rng, config = calls.get()
    try:
        hand = HandSearch(plan, side, rng, config)
    except (CadenzaError, ImportError):
        return
    answer(True)
    search = RestartingSearch(hand, plan.track.config.control_timestep)
    step = num_begins = windows_to_find = 0
    while True:
        ends = search.is_over or plan.ends_before(step + search.lookahead)
        try:
            name, *arguments = calls.get(block=not windows_to_find or ends)
        except Empty:
            window = search.next_window()
            answer((num_begins, window))
            step, windows_to_find = step + len(window), windows_to_find - 1
            continue
        if name == "follow":
            plan = arguments[0]
            search.follow(*arguments)
        elif name == "act":
            windows_to_find = 0
            answer(search.act(*arguments))
        elif name == "begin":
            search.begin(*arguments)
            step, num_begins, windows_to_find = arguments[0].step, num_begins + 1, _AHEAD
        else:
            windows_to_find += 1


if __name__ == "__main__":
    main()
