"""The search for one hand's controls, a window ahead and with random restarts.

The hand plays ahead in its own model, half a second and then another. Where notes go wrong in the
first, it goes back and searches again with other random numbers; what costs least over both is
kept. As the model moves nearly as the whole scene does, the controls are then played as they were
found, with feedback to where the hand was in the model. Where it does not, because the hands touch
or something pushes them, the hand goes on step by step.

As a hand needs nothing from the scene before it is somewhere else than in its model, an idle thread
finds the next windows while the scene plays this one, or waits for the other hand.
"""

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from threading import Lock
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.hand_search import HandSearch, PlayedStep, Snapshot
from cadenza.sim.threads import Threads

_WINDOW = 0.5  # [s], that of a rehearsal
RESTARTS = 3  # the most restarts, one after the other
RESTARTS_PER_WINDOW = 0.5
"""What a hand may restart in the mean, which bounds its time; what it saves is for later ones."""
_WRONG_NOTE = 3.0  # cost of a wrong note beyond that of its keys and onsets
_MAX_DRIFT = 0.01  # [m, rad] between the model and the scene up to which controls are played
_MAX_WAIT = 8  # windows that a hand plays step by step at most before it plays ahead again
_MAX_AHEAD = 3  # windows that are found beforehand at most


class _Branch(NamedTuple):
    """Two windows as the hand played them in its own model."""

    played: list[PlayedStep]
    cost: float
    wrong_notes: int  # in the first window
    middle: Snapshot
    end: Snapshot


class _Window(NamedTuple):
    """A window whose controls have been found."""

    played: deque[PlayedStep]
    ends_at: Array  # (J,) where the hand is after it [m, rad]
    after: Snapshot  # of the search, once it had found them


class SearchAhead:
    """The controls of one hand, found a window or more ahead of where the scene is.

    They are the same, to the bit, for any number of threads.
    """

    def __init__(self, search: HandSearch, dt: float, threads: Threads) -> None:
        """Take over a search that has not begun, of a hand in control steps of `dt` [s]."""
        self._search, self._window, self._threads = search, steps_in(_WINDOW, dt), threads
        self._max_wait = _MAX_WAIT * self._window
        self._second = list[PlayedStep]()  # what follows the last window that was found
        self._affordable = float(RESTARTS)  # restarts
        self._one_by_one, self._wait = 0, self._window  # steps still to be played so, and next time
        self._current: _Window | None = None
        self._next = deque[_Window]()
        self._searching = Lock()  # for whoever uses the search
        self._running: Future[None] | None = None

    @property
    def lookahead(self) -> int:
        """Number of steps of the plan that are needed."""
        return self._search.lookahead + 2 * self._window

    @property
    def simulated(self) -> int:
        """Control steps in rollouts and rehearsals of the windows that have begun to be played."""
        return self._current.after.simulated if self._current else self._search.simulated

    def goes_on(self, hand_qpos: Array) -> bool:
        """Whether the controls of the next step have been found, for joints (J,) as they are."""
        ahead = self._current.played if self._current else ()
        return bool(ahead) and not self._has_drifted(hand_qpos)

    def act(self, step: int, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> Array:
        """Controls (A,) of a step from the hand's joints (J,) and all keys (K,)."""
        if self._current and self._has_drifted(hand_qpos):
            self._give_up(self._current, step)
        if self._one_by_one:
            self._one_by_one -= 1
            return self._search.act(hand_qpos, hand_qvel, key_qpos)
        window = self._current
        if not window or not window.played:
            window = self._next_window(hand_qpos, hand_qvel, key_qpos)
        return self._search.tracked(step, window.played.popleft(), hand_qpos, hand_qvel)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a plan that goes further."""
        with self._searching:
            self._search.follow(plan, step)

    def stop(self) -> None:
        """Find no more windows."""
        with self._searching:
            self._next.clear()
            self._second = []

    def _has_drifted(self, hand_qpos: Array) -> bool:
        """Whether the hand, at joints (J,), is somewhere else than in its model."""
        if not (window := self._current):
            return False
        expected = window.played[0].hand_qpos if window.played else window.ends_at
        return bool(np.abs(expected - hand_qpos).max() > _MAX_DRIFT)

    def _give_up(self, window: _Window, step: int) -> None:
        """Leave a window before `step`, and forget what was found after it."""
        with self._searching:
            self._next.clear()
            self._second, self._current, self._affordable = [], None, 0.0
            self._search.rewind(window.after)
            self._search.go_back(step)
        self._one_by_one, self._wait = self._wait, min(2 * self._wait, self._max_wait)

    def _next_window(self, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> _Window:
        """Go over to the next window, and have those after it found meanwhile."""
        if self._running and self._running.done():
            self._running.result()  # raises what it has raised
        with self._searching:
            if self._current:  # it has been played through
                self._wait = self._window
            else:
                self._search.synchronise(hand_qpos, hand_qvel, key_qpos)
                self._begin()
            self._current = self._next.popleft() if self._next else self._find_window()
        if not self._running or self._running.done():
            self._running = self._threads.meanwhile(self._find_more)
        return self._current

    def _find_more(self) -> None:
        """Find the next windows, as far as the plan goes."""
        while len(self._next) < _MAX_AHEAD:
            with self._searching:
                if not self._second or not self._search.has_planned(self._window):
                    return
                self._next.append(self._find_window())

    def _begin(self) -> None:
        """Play the first window where the hand is."""
        self._start = self._search.save()
        steps = min(self._window, self._search.steps_left)
        self._second = [self._search.play() for _ in range(steps)]
        self._middle = self._search.save()

    def _find_window(self) -> _Window:
        """The controls of the next window, found by restarts where notes go wrong in it."""
        branch = self._play(self._second, np.inf)
        assert branch is not None
        self._affordable = min(self._affordable + RESTARTS_PER_WINDOW, RESTARTS)
        while branch.wrong_notes and self._affordable >= 1.0:
            self._affordable -= 1.0
            self._search.restore(self._start)
            branch = self._play([], branch.cost) or branch
        self._search.restore(branch.end)
        self._start, self._middle = branch.middle, branch.end
        self._second = branch.played[self._window :]
        played, ends_at = deque(branch.played[: self._window]), branch.middle.state.hand_qpos[0]
        return _Window(played, ends_at, self._search.save())

    def _play(self, played: Sequence[PlayedStep], limit: float) -> _Branch | None:
        """Play two windows, of which the first may have been `played`; None if it costs `limit`."""
        horizon = self._search.cost(self._start, 2 * self._window)
        steps, middle = list(played), self._middle
        keys, cost, wrong_notes = horizon.start, 0.0, 0
        for k in range(horizon.num_steps):
            if k == len(steps):
                if k == self._window:
                    middle = self._search.save()
                steps.append(self._search.play())
            path, fingertips = steps[k].key_path[None], steps[k].fingertips[None]
            [(more, _, keys)] = horizon.costs(k, path, fingertips, keys)
            cost += more + _WRONG_NOTE * keys.wrong_notes
            wrong_notes += keys.wrong_notes * (k < self._window)
            if cost >= limit:
                return None
        return _Branch(steps, cost, wrong_notes, middle, self._search.save())
