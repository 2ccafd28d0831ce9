"""The search for one hand's controls, a window ahead and with random restarts.

The hand plays two windows of half a second ahead in its own model. If notes go wrong in the first,
it goes back and searches again with other random numbers, and the cheapest of these branches is
kept. Its controls are then played in the scene, with feedback to the states of the model, which
moves nearly as the whole scene does. If it does not, because the hands touch or something pushes
them, the hand goes on step by step.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple, Protocol

import numpy as np

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.search.hand_search import (
    HandSearch,
    PlayedStep,
    SimulatedStep,
    Snapshot,
)
from cadenza.scene.scene import HandAlone
from cadenza.scene.servos import servos_of

_WINDOW = 0.5  # [s], that of a rehearsal
RESTARTS = 3  # maximum restarts in a row
RESTARTS_PER_WINDOW = 0.5
"""Mean number of restarts, which bounds the time; unused ones are saved for later windows."""
_WRONG_NOTE = 3.0  # cost of a wrong note beyond that of its keys and onsets
_MAX_DRIFT = 0.01  # [m, rad] between the model and the scene up to which controls are played
_MAX_WAIT = 8  # maximum windows that a hand plays step by step before it plays ahead again


class HandState(NamedTuple):
    """A hand and the keys in the scene, before a step."""

    step: int
    hand_qpos: Array  # (J,) [m, rad]
    hand_qvel: Array  # (J,) [m/s, rad/s]
    key_qpos: Array  # (K,) [rad]


class WindowSearch(Protocol):
    """A search for controls of one hand window by window, in this or another process."""

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""

    def act(self, state: HandState) -> Array:
        """Controls (A,) of the next step alone."""

    def begin(self, state: HandState) -> None:
        """Find windows from a state on."""

    def next_window(self) -> list[PlayedStep]:
        """The next window, as the hand played it in its own model; the last may be shorter."""


class _Branch(NamedTuple):
    """Two windows as the hand played them in its own model."""

    steps: list[SimulatedStep]
    cost: float
    wrong_notes: int  # in the first window
    middle: Snapshot
    end: Snapshot


class RestartingSearch:
    """A `WindowSearch` that restarts if notes go wrong.

    Attributes:
        search: the search step by step.
    """

    def __init__(self, search: HandSearch, dt: float) -> None:
        """Take over a search that has not begun, of a hand in control steps of `dt` [s]."""
        self.search, self._window = search, steps_in(_WINDOW, dt)
        self._second = list[SimulatedStep]()  # of the last two windows
        self._is_ahead = False  # of the scene
        self._restarts_left = float(RESTARTS)

    @property
    def lookahead(self) -> int:
        """Number of steps of the plan that are needed, from the next window on."""
        return self.search.lookahead + 2 * self._window

    def follow(self, plan: SongPlan, step: int) -> None:
        self.search.follow(plan, step)

    @property
    def is_over(self) -> bool:
        """Whether there is no further window."""
        return not self._second

    def act(self, state: HandState) -> Array:
        if self._is_ahead:
            self._is_ahead, self._second, self._restarts_left = False, [], 0.0
            self.search.go_back(state.step)
        return self.search.act(*state[1:])

    def begin(self, state: HandState) -> None:
        self.search.synchronise(*state[1:])
        self._is_ahead = True
        self._start = self.search.save()
        steps = min(self._window, self.search.steps_left)
        self._second = [self.search.play() for _ in range(steps)]
        self._middle = self.search.save()

    def next_window(self) -> list[PlayedStep]:
        branch = self._play(self._second, np.inf)
        assert branch is not None
        self._restarts_left = min(self._restarts_left + RESTARTS_PER_WINDOW, RESTARTS)
        while branch.wrong_notes and self._restarts_left >= 1.0:
            self._restarts_left -= 1.0
            self.search.restore(self._start)
            branch = self._play([], branch.cost) or branch
        self.search.restore(branch.end)
        self._start, self._middle = branch.middle, branch.end
        self._second = branch.steps[self._window :]
        return [step.played for step in branch.steps[: self._window]]

    def _play(self, played: Sequence[SimulatedStep], limit: float) -> _Branch | None:
        """Play two windows, of which some steps are `played`; None if they cost `limit` or more."""
        horizon = self.search.cost(self._start, 2 * self._window)
        steps, middle = list(played), self._middle
        keys, cost, wrong_notes = horizon.start, 0.0, 0
        for k in range(horizon.num_steps):
            if k == len(steps):
                if k == self._window:
                    middle = self.search.save()
                steps.append(self.search.play())
            path, fingertips = steps[k].key_path[None], steps[k].fingertips[None]
            [(step_cost, _, keys)] = horizon.costs(k, path, fingertips, keys)
            cost += step_cost + _WRONG_NOTE * keys.wrong_notes
            wrong_notes += keys.wrong_notes * (k < self._window)
            if cost >= limit:
                return None
        return _Branch(steps, cost, wrong_notes, middle, self.search.save())


class SearchAhead:
    """The controls of one hand in the scene, found a window ahead."""

    def __init__(self, windows: WindowSearch, plan: SongPlan, hand: HandAlone, dt: float) -> None:
        """Play the controls of `windows` for a hand of a plan, in control steps of `dt` [s]."""
        self._windows, self._window = windows, steps_in(_WINDOW, dt)
        self._servos, self._among_all = servos_of(hand.scene), hand.servos
        self._max_wait = _MAX_WAIT * self._window
        self._queue = deque[PlayedStep]()
        self._is_searching = False  # for windows
        self._one_by_one, self._wait = 0, self._window  # steps left to play one by one; next time
        self._tracking = plan.nominal.tracking.of(hand.servos)

    def follow(self, plan: SongPlan, step: int) -> None:
        """Continue from `step` on with a longer plan."""
        self._windows.follow(plan, step)
        self._tracking = plan.nominal.tracking.of(self._among_all)

    def act(self, state: HandState) -> Array:
        """Controls (A,) of a step."""
        window_ends = self._is_searching and not self._queue
        if window_ends:
            self._queue.extend(self._windows.next_window())
        if self._queue and np.abs(self._queue[0].hand_qpos - state.hand_qpos).max() > _MAX_DRIFT:
            self._queue.clear()
            self._is_searching = False
            self._one_by_one, self._wait = self._wait, min(2 * self._wait, self._max_wait)
        elif window_ends:
            self._wait = self._window
        if self._one_by_one:
            self._one_by_one -= 1
            return self._windows.act(state)
        if not self._is_searching:
            self._windows.begin(state)
            self._is_searching = True
            self._queue.extend(self._windows.next_window())
        return self._track(state, self._queue.popleft())

    def _track(self, state: HandState, played: PlayedStep) -> Array:
        """Controls (A,) of a step that the model played, with feedback to its state."""
        drift = state.hand_qpos - played.hand_qpos, state.hand_qvel - played.hand_qvel
        feedback = self._tracking.gain[state.step] * self._servos.state(*drift)
        return self._servos.clip(played.ctrl - feedback.sum(axis=1))
