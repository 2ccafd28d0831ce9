"""The search for one hand's controls, a window ahead and with random restarts.

The hand plays ahead in its own model, half a second and then another. Where notes go wrong in the
first, it goes back and searches again with other random numbers; what costs least over both is
kept. As the model moves nearly as the whole scene does, the controls are then played as they were
found, with feedback to where the hand was in the model. Where it does not, because the hands touch
or something pushes them, the hand goes on step by step.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, steps_in
from cadenza.agents.planner.search.hand_search import HandSearch, PlayedStep, Snapshot

_WINDOW = 0.5  # [s], that of a rehearsal
RESTARTS = 3  # the most restarts, one after the other
RESTARTS_PER_WINDOW = 0.5
"""What a hand may restart in the mean, which bounds its time; what it saves is for later ones."""
_WRONG_NOTE = 3.0  # cost of a wrong note beyond that of its keys and onsets
_MAX_DRIFT = 0.01  # [m, rad] between the model and the scene up to which controls are played
_MAX_WAIT = 8  # windows that a hand plays step by step at most before it plays ahead again


class _Branch(NamedTuple):
    """Two windows as the hand played them in its own model."""

    played: list[PlayedStep]
    cost: float
    wrong_notes: int  # in the first window
    middle: Snapshot
    end: Snapshot


class SearchAhead:
    """The controls of one hand, found a window ahead of where the scene is."""

    def __init__(self, search: HandSearch, dt: float) -> None:
        """Take over a search that has not begun, of a hand in control steps of `dt` [s]."""
        self._search, self._window = search, steps_in(_WINDOW, dt)
        self._max_wait = _MAX_WAIT * self._window
        self._found, self._second = list[PlayedStep](), list[PlayedStep]()
        self._affordable = float(RESTARTS)  # restarts
        self._one_by_one, self._wait = 0, self._window  # steps still to be played so, and next time

    @property
    def lookahead(self) -> int:
        """Number of steps of the plan that are needed."""
        return self._search.lookahead + 2 * self._window

    def act(self, step: int, hand_qpos: Array, hand_qvel: Array, key_qpos: Array) -> Array:
        """Controls (A,) of a step from the hand's joints (J,) and all keys (K,)."""
        ahead = self._found or self._second
        if ahead and np.abs(ahead[0].hand_qpos - hand_qpos).max() > _MAX_DRIFT:
            self._found, self._second, self._affordable = [], [], 0.0
            self._one_by_one, self._wait = self._wait, min(2 * self._wait, self._max_wait)
            self._search.go_back(step)
        if self._one_by_one:
            self._one_by_one -= 1
            return self._search.act(hand_qpos, hand_qvel, key_qpos)
        if not self._found:
            if self._second:  # a window has been played through
                self._wait = self._window
            else:
                self._search.synchronise(hand_qpos, hand_qvel, key_qpos)
                self._begin()
            self._find_window()
        return self._search.tracked(step, self._found.pop(0), hand_qpos, hand_qvel)

    def _begin(self) -> None:
        """Play the first window where the hand is."""
        self._start = self._search.save()
        steps = min(self._window, self._search.steps_left)
        self._second = [self._search.play() for _ in range(steps)]
        self._middle = self._search.save()

    def _find_window(self) -> None:
        """Find the controls of the next window, by restarts where notes go wrong in it."""
        branch = self._play(self._second, np.inf)
        assert branch is not None
        self._affordable = min(self._affordable + RESTARTS_PER_WINDOW, RESTARTS)
        while branch.wrong_notes and self._affordable >= 1.0:
            self._affordable -= 1.0
            self._search.restore(self._start)
            branch = self._play([], branch.cost) or branch
        self._search.restore(branch.end)
        self._start, self._middle = branch.middle, branch.end
        self._found, self._second = branch.played[: self._window], branch.played[self._window :]

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
