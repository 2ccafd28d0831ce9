"""The search of one hand in a process of its own, while this one searches for another hand.

`python -m cadenza.agents.planner.search.hand_process` is that process. It receives pickled calls of
the methods of a `RestartingSearch` on stdin, and answers on stdout. It finds a few windows ahead
of what is asked for. The result is the same to the bit as in this process.
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

_AHEAD = 2  # windows that are found before they are asked for
_LOST = (
    "the process that searches for the {side} hand ended unexpectedly: is there enough memory? "
    "--num-threads 1 does without it"
)


class HandProcess:
    """A `WindowSearch` in another process, which ends with this object."""

    def __init__(self) -> None:
        """Start the process, which loads all that it needs. Raises OSError if there is no room."""
        module = "cadenza.agents.planner.search.hand_process"
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},  # modules of hands, too
        )
        weakref.finalize(self, _end, self._process)
        self._begun, self._side = 0, "other"

    def search(
        self, plan: SongPlan, side: Side, rng: np.random.Generator, config: PlannerConfig
    ) -> None:
        """Prepare to search for the hand on one side; see `HandSearch`."""
        self._side = side
        try:
            self._call(plan, side, rng, config)
        except (CadenzaError, pickle.PicklingError, AttributeError, TypeError):
            self._process.kill()  # of what cannot be pickled, it is never told

    def is_ready(self) -> bool:
        """Whether it can search: not if it does not know the hand, which this process does."""
        with suppress(CadenzaError):
            return bool(self._answer())
        return False

    def follow(self, plan: SongPlan, step: int) -> None:
        self._call("follow", plan, step)

    def act(self, state: HandState) -> Array:
        self._call("act", state)
        while isinstance(answer := self._answer(), tuple):
            pass  # a window that was found ahead of what has happened
        return np.asarray(answer)

    def begin(self, state: HandState) -> None:
        self._begun += 1
        self._call("begin", state)

    def next_window(self) -> list[PlayedStep]:
        self._call("next_window")
        while True:
            begun, window = self._answer()
            if begun == self._begun:
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
        except (EOFError, pickle.UnpicklingError):  # at once, or within an answer
            raise CadenzaError(_LOST.format(side=self._side)) from None


def _end(process: "subprocess.Popen[bytes]") -> None:
    """Kill the process, and wait for it, so that its CPU time counts as that of a child."""
    process.kill()
    for pipe in process.stdin, process.stdout:
        assert pipe is not None
        with suppress(OSError):  # what was not sent is of no use
            pipe.close()
    process.wait()


def main() -> None:
    """Search for a hand until there is nobody to search for."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this ends it
    calls = SimpleQueue[Any]()
    with os.fdopen(os.dup(1), "wb") as answers:
        os.dup2(2, 1)  # what libraries print is no answer
        threading.Thread(target=_receive, args=(calls,), daemon=True).start()

        def answer(value: Any) -> None:
            pickle.dump(value, answers)
            answers.flush()

        _serve(calls, answer)


def _receive(calls: SimpleQueue[Any]) -> None:
    """Receive calls as they come, even while one is carried out, and end where nobody calls.

    It also ends at what it does not know, such as a hand that its parent alone has registered.
    """
    with suppress(Exception):
        while True:
            calls.put(pickle.load(sys.stdin.buffer))
    os._exit(0)


def _serve(calls: SimpleQueue[Any], answer: Callable[[Any], None]) -> None:
    """Carry out calls, and find windows ahead while there are none."""
    plan, side, rng, config = calls.get()
    try:
        hand = HandSearch(plan, side, rng, config)
    except (CadenzaError, ImportError):
        return
    answer(True)
    search = RestartingSearch(hand, plan.track.config.control_timestep)
    step = begun = wanted = 0
    while True:
        ends = search.is_over or plan.ends_before(step + search.lookahead)
        try:
            name, *arguments = calls.get(block=not wanted or ends)
        except Empty:
            window = search.next_window()
            answer((begun, window))
            step, wanted = step + len(window), wanted - 1
            continue
        if name == "follow":
            plan = arguments[0]
            search.follow(*arguments)
        elif name == "act":
            wanted = 0
            answer(search.act(*arguments))
        elif name == "begin":
            search.begin(*arguments)
            step, begun, wanted = arguments[0].step, begun + 1, _AHEAD
        else:
            wanted += 1


if __name__ == "__main__":
    main()
