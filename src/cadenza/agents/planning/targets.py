"""Where the fingertips have to be when: boxes in space that they keep to."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.planning.presses import Press
from cadenza.scene.piano import (
    BLACK,
    IS_BLACK,
    KEY_CENTRE,
    KEY_HALF_SIZE,
    KEY_TRAVEL,
    holding_torque,
)

Array = NDArray[np.float64]

NUM_FINGERS = 10
_RADIUS = np.array([0.0082] + [0.0067] * 4)  # of the fingertips' ends, thumb to little [m]

# Where keys are pressed, towards the player from the middle of the keyboard's depth [m]: whites
# clear of the blacks, the thumb near their edge, as it is shorter, and blacks on their ridge.
_ON_WHITE, _THUMB_ON_WHITE, _ON_BLACK = 0.047, 0.056, 0.0
_BLACK_TOP = BLACK.centre_z + BLACK.half_size[2]
_IN_FRONT_OF_BLACK = 0.025
_OVER_KEYS = (-0.04, 0.066)  # [m] where idle fingertips stay

_TOLERANCE = (0.003, 0.001)  # [m] along the key, across it
_DEEP = 0.0015  # [m] below where the key stops
_HOVER, _HOVER_ROOM = 0.006, 0.006  # [m] above a key that is pressed next
_LIFTED = 0.008  # [m] above a key that was let go, and above all keys for an idle finger
_APPROACH = 4  # states before a press in which its finger gets over the key
# More than what just holds the key down, so that it sounds in spite of what is not modelled.
_FORCE_MARGIN = 1.6

# What a box is worth: the distance from it [m] that counts as one standard deviation.
_X_SIGMA = 0.006
_AT_KEY = np.array([_X_SIGMA, 0.0015, 0.001])
_ABOVE_KEY = np.array([_X_SIGMA, 0.0015, 0.003])
_IDLE = np.array([0.005, 1.0, 0.006])
_IN_FLIGHT = np.array([16.0, 16.0, 1.0])  # times as far in a jump, where only the height matters


class Targets(NamedTuple):
    """Boxes for the fingertips in S states, (S, 10, 3) each, and what they press with."""

    low: Array
    high: Array
    sigma: Array
    """Distances from the box that count as one [m]."""
    wall: Array
    """(S, 10) nearest to the player that black keys are: the least x [m]."""
    force: Array
    """(S, 10) downwards [N]."""


def targets_of(presses: Sequence[Press], num_states: int) -> Targets:
    """Where `presses` want the fingertips; idle ones stay above all keys."""
    targets = _idle(num_states)
    for finger in range(NUM_FINGERS):
        mine = [press for press in presses if press.finger == finger]
        before = 0
        for press, following in pairwise([*mine, None]):
            assert press is not None
            _approach(targets, press, before)
            _hold(targets, press)
            if press.last < num_states and (following is None or following.first > press.last):
                _let_go(targets, press)
            before = press.last
    return targets


def _idle(num_states: int) -> Targets:
    shape = (num_states, NUM_FINGERS, 3)
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    low[:, :, 0], high[:, :, 0] = _OVER_KEYS
    low[:, :, 2] = _BLACK_TOP + _LIFTED + np.tile(_RADIUS, 2)
    sigma = np.broadcast_to(_IDLE, shape).copy()
    return Targets(low, high, sigma, np.full(shape[:2], -np.inf), np.zeros(shape[:2]))


def _approach(targets: Targets, press: Press, before: int) -> None:
    """Over the key, the nearer in time the more closely, and low in the last state."""
    over = _at(press, angle=0.0)
    for state in range(max(press.first - _APPROACH, before + 1, 1), press.first):
        steps = press.first - state
        low = over[2] + (_HOVER if steps == 1 else _HOVER + 0.004)
        high = over[2] + _HOVER + _HOVER_ROOM if steps == 1 else np.inf
        sigma = _ABOVE_KEY * steps
        sigma[2] = _ABOVE_KEY[2] if steps == 1 else _IDLE[2]
        if press.flies_to:
            sigma *= _IN_FLIGHT
        _box(targets, press, state, over, (low, high), sigma)


def _hold(targets: Targets, press: Press) -> None:
    at = _at(press, KEY_TRAVEL[press.key])
    depth = at[2] - _DEEP
    states = slice(press.first, press.last)
    _box(targets, press, states, at, (depth, depth), _AT_KEY)
    lever = at[0] - KEY_CENTRE[press.key, 0] + KEY_HALF_SIZE[press.key, 0]
    targets.force[states, press.finger] = _FORCE_MARGIN * holding_torque(press.key) / lever


def _let_go(targets: Targets, press: Press) -> None:
    """Straight up before it goes anywhere, or it would drag along the key; in a jump just up."""
    over = _at(press, angle=0.0)
    sigma = _ABOVE_KEY * _IN_FLIGHT if press.flies_off else _ABOVE_KEY
    _box(targets, press, press.last, over, (over[2] + _LIFTED, np.inf), sigma)


def _box(
    targets: Targets,
    press: Press,
    states: int | slice,
    at: Array,
    height: tuple[float, float],
    sigma: Array,
) -> None:
    room = np.array(_TOLERANCE)
    targets.low[states, press.finger] = (*(at[:2] - room), height[0])
    targets.high[states, press.finger] = (*(at[:2] + room), height[1])
    targets.sigma[states, press.finger] = sigma
    if not IS_BLACK[press.key]:
        targets.wall[states, press.finger] = _IN_FRONT_OF_BLACK


def _at(press: Press, angle: float) -> Array:
    """(3,) where the fingertip touches the key when that is down by `angle` [rad]."""
    centre, half = KEY_CENTRE[press.key], KEY_HALF_SIZE[press.key]
    thumb = press.finger % 5 == 0
    x = _ON_BLACK if IS_BLACK[press.key] else _THUMB_ON_WHITE if thumb else _ON_WHITE
    fall = np.tan(angle) * (x - centre[0] + half[0])
    return np.array([x, centre[1], centre[2] + half[2] - fall + _RADIUS[press.finger % 5]])
