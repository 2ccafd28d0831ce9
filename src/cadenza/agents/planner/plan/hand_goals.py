"""Goals of one hand in a plan, step by step."""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.control_steps import steps_in
from cadenza.agents.planner.plan.presses import RISE
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.fingers import SIDES, Side
from cadenza.music.metrics import ONSET_TOLERANCE

Mask = NDArray[np.bool_]

ABOUT_TO_PRESS = 0.1  # [s] before a press
ASTRAY = 3000.0  # [1 / m^2] weight of a playing fingertip's squared distance from the plan
_IDLE_ASTRAY = 200.0  # [1 / m^2] the same of an idle one, which only has to be out of the way
_LEAVING = 0.1  # [s] that a hand needs to leave a key of the other's
_ROUNDING = 1e-9  # so that a whole number of steps counts as such


class HandGoals:
    """Goals of one hand over T steps, of which the first P are planned.

    Attributes:
        mine: (T, K) whether this hand should hold a key down.
        asked: (T, K) the finger that should hold it, 0 for the thumb.
        planned: (T, K) whether the plan holds it down, as far as it goes.
        wrong: (T, K) whether the hand should not hold the key down.
        due: (T, K) whether its key is late unless it sounds by then.
        unwelcome: (T, K) whether a key, its own or a wrong one, should not begin to sound.
        fingertips: (P + 1, F, 3) planned places of its F fingertips [m].
        fingers: the numbers of its fingers in the scene.
        playing: (T + 1, F) whether a finger is about to press, presses, or lets go by the plan.
        weight: (T + 1, F) weights of the squared distances of fingertips from the plan [1 / m^2].
    """

    def __init__(self, plan: SongPlan, side: Side) -> None:
        """Args:
        plan: of the song.
        side: of the hand.
        """
        dt = plan.track.config.control_timestep
        keys, fingers, nominal = plan.goals.keys, plan.goals.fingers, plan.nominal
        self.fingers = plan.scene.fingers.of_hand(SIDES.index(side))
        thumb, count = self.fingers.start, plan.scene.fingers.per_hand
        self.mine = keys & (fingers >= thumb) & (fingers < self.fingers.stop)
        self.asked = fingers - np.int8(thumb)
        others = keys & ~self.mine
        soon = others.copy()
        for late in range(1, steps_in(_LEAVING, dt) + 1):
            soon[late:] |= others[:-late]
        self.wrong = ~keys & ~soon
        self.due = self.mine & (last_in_time(keys, dt) >= 0)
        self.unwelcome = (self.mine | self.wrong) & ~may_begin(keys, dt)
        row = count * plan.scene.sides.index(side)
        self.fingertips = nominal.fingertips[:, row : row + count]
        self.planned = np.zeros_like(self.mine)
        self.playing = np.zeros((len(keys) + 1, count), bool)
        about_to_press, rise = steps_in(ABOUT_TO_PRESS, dt), steps_in(RISE, dt)
        for press in nominal.presses:
            if press.side == side:
                self.planned[press.first - 1 : press.last - 1, press.key] = True
                about = max(press.first - about_to_press, 0)
                self.playing[about : press.last + rise, press.finger - thumb] = True
        self.weight = np.where(self.playing, ASTRAY, _IDLE_ASTRAY)

    def holding(self, sounding: Mask) -> HandGoals:
        """The same, but planned are those of this hand's keys that are `sounding` (T, K)."""
        part = copy(self)
        part.planned = self.mine & sounding
        return part


def last_in_time(keys: Mask, dt: float) -> NDArray[np.int8]:
    """(T, K) the last step in which a note of `keys` (T, K) still begins in time; elsewhere -1.

    The value is the number of control steps of `dt` [s] from the note's first one to there. A note
    is in time as `cadenza.music.metrics` counts onsets, or sooner: one whose key was down two steps
    before may have been struck again, so that it begins a step late at best.
    """
    first, steps = first_steps(keys), _steps_in_time(dt)
    again, sooner = first & later(keys, 2), max(steps - 1, 0)
    # Small numbers: of a long song, whole arrays of large ones take most of the time of its part.
    last = np.where(later(first & ~again, steps), np.int8(steps), np.int8(-1))
    return np.where(later(again, sooner), np.int8(sooner), last)


def may_begin(keys: Mask, dt: float) -> Mask:
    """(T, K) steps in which notes of `keys` (T, K) may begin: their first one, or a little late.

    `dt` is the control step [s].
    """
    first = first_steps(keys)
    return np.any([later(first, steps) for steps in range(_steps_in_time(dt) + 1)], axis=0)


def first_steps(keys: Mask) -> Mask:
    """(T, K) the first step of each note of `keys` (T, K)."""
    return keys & ~later(keys, 1)


def _steps_in_time(dt: float) -> int:
    """Control steps of `dt` [s] by which an onset may be late."""
    return int(ONSET_TOLERANCE / dt + _ROUNDING)


def later(keys: Mask, steps: int) -> Mask:
    """The same keys (T, K), so many steps later."""
    return np.pad(keys, ((steps, 0), (0, 0)))[: len(keys)]
