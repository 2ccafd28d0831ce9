"""Where the fingertips have to be when: boxes in space that they keep to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planning.control_steps import steps_in
from cadenza.agents.planning.presses import RISE, Press
from cadenza.fingers import SIDES
from cadenza.scene.scene import Scene

Array = NDArray[np.float64]

# Where fingertips press and stay, towards the player from the middle of the white keys [m].
_ON_BLACK = 0.0  # on their ridge; on white ones as suits the finger, clear of the black
_FROM_FRONT = 0.004  # not nearer to the player's end of white keys
_BEFORE_BLACK, _BESIDE_BLACK = 0.01, 0.0015  # in front of black keys; from them to the finger
_OVER_KEYS = (-0.04, 0.066)  # idle ones

_TOLERANCE = (0.003, 0.001)  # [m] along the key, across it
_DEEP = 0.0015  # [m] below where the key stops
_HOVER, _HOVER_ROOM = 0.006, 0.006  # [m] above a key that is pressed next
_LIFTED = 0.008  # [m] above a key that was let go, and above all keys for an idle finger
_APPROACH = 0.2  # [s] before a press in which its finger gets over the key
_READY = 0.05  # [s] of them in which it is just above it
# More than what just holds the key down, so that it sounds in spite of what is not modelled.
_FORCE_MARGIN = 1.6
# As many times that where it goes down, in which its inertia has to be overcome; on a black key
# a fingertip would slip off.
_STRIKE = 1.5
_STRIKING = 0.05  # [s]

# What a box is worth: the distance from it [m] that counts as one standard deviation.
_X_ON_BLACK = 0.5  # times as far on black keys, in front of which a fingertip is caught
# Closely along it as well: friction holds a fingertip that is to slide, and the hand is late.
_AT_KEY = np.array([0.003, 0.0015, 0.001])
_ABOVE_KEY = np.array([0.006, 0.0015, 0.003])
_IDLE = np.array([0.005, 1.0, 0.006])
_IN_FLIGHT = np.array([16.0, 16.0, 1.0])  # times as far in a jump, where only the height matters
_BEFORE_LANDING_ON_BLACK = np.array([2.0, 2.0, 1.0])  # just before


class Targets(NamedTuple):
    """Boxes for the fingertips in S states, (S, F, 3) each, and what they press with."""

    low: Array
    high: Array
    sigma: Array
    """Distances from the box that count as one [m]."""
    wall: Array
    """(S, F) nearest to the player that black keys are: the least x [m]."""
    force: Array
    """(S, F) downwards [N]."""

    def part(self, first: int, last: int) -> Targets:
        """The states from `first` up to, not including, `last`, as views."""
        return Targets._make(rows[first:last] for rows in self)


def pressing(sinking: Array, force: Array) -> Array:
    """(S, A) the force along each servo's coordinate that presses keys.

    Args:
        sinking: (S, F, A) how the fingertips' heights change with the coordinates.
        force: (S, F) of the fingertips, downwards [N].
    """
    return -np.einsum("sfa,sf->sa", sinking, force)


def targets_of(scene: Scene, presses: Sequence[Press], num_states: int, dt: float) -> Targets:
    """Where `presses` want the fingertips of a scene's hands; idle ones stay above all keys.

    States are `dt` [s] apart.
    """
    return _Writer(scene, num_states, dt).write(presses)


class _Writer:
    """Writes presses into targets that begin with all fingers idle."""

    def __init__(self, scene: Scene, num_states: int, dt: float) -> None:
        self._dt = dt
        self._keyboard = scene.keyboard
        fingers = self._fingers = scene.hand.fingers * len(SIDES)
        radius = np.array([finger.tip_radius for finger in fingers])
        black = scene.keyboard.black
        # To the micrometre: the sum must not depend on how its parts are written.
        front = black.centre_x + black.half_size[0]
        self._walls = np.round(front + np.maximum(_BEFORE_BLACK, radius + _BESIDE_BLACK), 6)
        shape = (num_states, len(fingers), 3)
        low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
        low[:, :, 0], high[:, :, 0] = _OVER_KEYS
        self._above_all = black.top + _LIFTED + radius
        low[:, :, 2] = self._above_all
        sigma = np.broadcast_to(_IDLE, shape).copy()
        self._targets = Targets(low, high, sigma, np.full(shape[:2], -np.inf), np.zeros(shape[:2]))

    def write(self, presses: Sequence[Press]) -> Targets:
        num_states = len(self._targets.low)
        for finger in range(len(self._fingers)):
            mine = [press for press in presses if press.finger == finger]
            before = 0
            for press, following in pairwise([*mine, None]):
                assert press is not None
                self._approach(press, before)
                self._hold(press)
                self._let_go(press, num_states if following is None else following.first)
                before = press.last
        return self._targets

    def _approach(self, press: Press, before: int) -> None:
        """Over the key, the nearer in time the more closely, and low when it is ready."""
        over = self._at(press, angle=0.0)
        approach, ready = steps_in(_APPROACH, self._dt), steps_in(_READY, self._dt)
        risen, states = before + steps_in(RISE, self._dt), len(self._targets.low)
        for state in range(max(press.first - approach, risen), min(press.first, states)):
            ahead = press.first - state
            is_ready = ahead <= ready
            low = over[2] + (_HOVER if is_ready else _HOVER + 0.004)
            if press.from_above and not is_ready:
                low = max(low, self._above_all[press.finger])
            high = over[2] + _HOVER + _HOVER_ROOM if is_ready else np.inf
            sigma = _ABOVE_KEY * max(ahead / ready, 1.0)
            sigma[2] = _ABOVE_KEY[2] if is_ready else _IDLE[2]
            if press.flies_to:
                lands = is_ready and self._keyboard.is_black[press.key]
                sigma *= _BEFORE_LANDING_ON_BLACK if lands else _IN_FLIGHT
            self._box(press, state, over, (low, high), sigma)

    def _hold(self, press: Press) -> None:
        keyboard, key = self._keyboard, press.key
        at = self._at(press, keyboard.travel[key])
        depth = at[2] - _DEEP
        states = slice(press.first, press.last)
        self._box(press, states, at, (depth, depth), _AT_KEY)
        lever = at[0] - keyboard.centre[key, 0] + keyboard.half_size[key, 0]
        force = _FORCE_MARGIN * keyboard.holding_torque[key] / lever
        self._targets.force[states, press.finger] = force
        if not keyboard.is_black[key]:
            struck = min(press.first + steps_in(_STRIKING, self._dt), press.last)
            self._targets.force[press.first : struck, press.finger] *= _STRIKE

    def _let_go(self, press: Press, until: int) -> None:
        """Straight up, or it would drag along the key; in a jump just up."""
        over = self._at(press, angle=0.0)
        sigma = _ABOVE_KEY * _IN_FLIGHT if press.flies_off else _ABOVE_KEY
        states = slice(press.last, min(press.last + steps_in(RISE, self._dt), until))
        self._box(press, states, over, (over[2] + _LIFTED, np.inf), sigma)

    def _box(
        self,
        press: Press,
        states: int | slice,
        at: Array,
        height: tuple[float, float],
        sigma: Array,
    ) -> None:
        targets, room = self._targets, np.array(_TOLERANCE)
        targets.low[states, press.finger] = (*(at[:2] - room), height[0])
        targets.high[states, press.finger] = (*(at[:2] + room), height[1])
        targets.sigma[states, press.finger] = sigma
        if self._keyboard.is_black[press.key]:
            targets.sigma[states, press.finger, 0] *= _X_ON_BLACK
        else:
            targets.wall[states, press.finger] = self._walls[press.finger]

    def _at(self, press: Press, angle: float) -> Array:
        """(3,) where the fingertip touches the key when that is down by `angle` [rad]."""
        keyboard, key = self._keyboard, press.key
        finger = self._fingers[press.finger]
        centre, half = keyboard.centre[key], keyboard.half_size[key]
        front = keyboard.white.centre_x + keyboard.white.half_size[0]
        x = _ON_BLACK if keyboard.is_black[key] else min(finger.on_white, front - _FROM_FRONT)
        fall = np.tan(angle) * (x - centre[0] + half[0])
        return np.array([x, centre[1], centre[2] + half[2] - fall + finger.tip_radius])
