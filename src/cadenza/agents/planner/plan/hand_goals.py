"""Goals of one hand in a plan, step by step."""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Mask, steps_in
from cadenza.agents.planner.plan.presses import RISE
from cadenza.agents.planner.plan.song_plan import SongPlan
from cadenza.agents.planner.plan.strike_model import PlannedStrikes
from cadenza.fingers import SIDES, Side
from cadenza.music.metrics import ONSET_TOLERANCE

ABOUT_TO_PRESS = 0.1  # time before a press in which its finger counts as playing [s]
TIP_WEIGHT = 3000.0  # weight of the squared distance of a playing fingertip from the plan [1 / m^2]
_IDLE_TIP_WEIGHT = 200.0  # [1 / m^2] of an idle fingertip, which only has to be out of the way
_LEAVING = 0.1  # [s] that a hand needs to leave a key of the other hand
_ROUNDING = 1e-9  # tolerance for a whole number of steps


class HandGoals:
    """Goals of one hand over T steps; the first P are planned.

    Attributes:
        keys: (T, K) whether this hand should hold a key down.
        finger: (T, K) the finger that should hold the key, 0 for the thumb.
        planned: (T, K) whether the plan holds the key down, as far as it goes.
        wrong: (T, K) whether the hand should not hold the key down.
        onset_due: (T, K) whether the key is late unless it sounds by then.
        onset_wrong: (T, K) whether the key, its own or a wrong one, should not begin to sound.
        fingertips: (P + 1, F, 3) planned places of the hand's F fingertips [m].
        fingers: the numbers of its fingers in the scene.
        strikes: how its keys are to begin to sound.
        playing: (T + 1, F) whether a finger is about to press, presses, or lets go by the plan.
        weight: (T + 1, F) weights of the squared distances of fingertips from the plan [1 / m^2].
    """

    def __init__(self, plan: SongPlan, side: Side) -> None:
        """Take the goals of the hand on one side from the plan of a song."""
        dt = plan.track.config.control_timestep
        keys, fingers, nominal = plan.goals.keys, plan.goals.fingers, plan.nominal
        self.fingers = plan.scene.fingers.of_hand(SIDES.index(side))
        thumb, count = self.fingers.start, plan.scene.fingers.per_hand
        self.keys = keys & (fingers >= thumb) & (fingers < self.fingers.stop)
        self.finger = fingers - np.int8(thumb)
        others = keys & ~self.keys
        others_or_before = np.any(
            [delayed(others, steps) for steps in range(steps_in(_LEAVING, dt) + 1)], axis=0
        )
        self.wrong = ~keys & ~others_or_before
        self.onset_due = self.keys & (last_in_time(keys, dt) >= 0)
        self.onset_wrong = (self.keys | self.wrong) & ~may_begin(keys, dt)
        is_own = self.keys[plan.strikes.step, plan.strikes.key]
        self.strikes = PlannedStrikes._make(values[is_own] for values in plan.strikes)
        self.dt = dt
        row = count * plan.scene.sides.index(side)
        self.fingertips = nominal.fingertips[:, row : row + count]
        self.planned = np.zeros_like(self.keys)
        self.playing = np.zeros((len(keys) + 1, count), bool)
        about_to_press, rise = steps_in(ABOUT_TO_PRESS, dt), steps_in(RISE, dt)
        for press in nominal.presses:
            if press.side == side:
                self.planned[press.first - 1 : press.last - 1, press.key] = True
                begin = max(press.first - about_to_press, 0)
                self.playing[begin : press.last + rise, press.finger - thumb] = True
        self.weight = np.where(self.playing, TIP_WEIGHT, _IDLE_TIP_WEIGHT)

    def holding(self, sounding: Mask) -> HandGoals:
        """These goals, with `sounding` keys (T, K) as those that the plan holds."""
        part = copy(self)
        part.planned = self.keys & sounding
        return part


def last_in_time(keys: Mask, dt: float) -> NDArray[np.int8]:
    """Last steps (T, K) in which notes of `keys` (T, K) still begin in time; elsewhere -1.

    The value is the number of control steps of `dt` [s] since the note's first step. A note is in
    time as `cadenza.music.metrics` counts onsets. If its key was down two steps before, it may be a
    repetition, which begins a step late at best; then the last step is one sooner.
    """
    first, steps = first_steps(keys), _steps_in_time(dt)
    repeats, steps_of_repeats = first & delayed(keys, 2), max(steps - 1, 0)
    # Eight bits: large arrays of a long song would take most of the time.
    last = np.where(delayed(first & ~repeats, steps), np.int8(steps), np.int8(-1))
    return np.where(delayed(repeats, steps_of_repeats), np.int8(steps_of_repeats), last)


def may_begin(keys: Mask, dt: float) -> Mask:
    """Steps (T, K) in which notes of `keys` (T, K) may begin: their first step, or a little later.

    `dt` is the control step [s].
    """
    first = first_steps(keys)
    return np.any([delayed(first, steps) for steps in range(_steps_in_time(dt) + 1)], axis=0)


def first_steps(keys: Mask) -> Mask:
    """First steps (T, K) of the notes of `keys` (T, K)."""
    return keys & ~delayed(keys, 1)


def _steps_in_time(dt: float) -> int:
    """Number of control steps of `dt` [s] by which an onset may be late."""
    return int(ONSET_TOLERANCE / dt + _ROUNDING)


def delayed(keys: Mask, steps: int) -> Mask:
    """Delay `keys` (T, K) by some steps."""
    return np.pad(keys, ((steps, 0), (0, 0)))[: len(keys)]
