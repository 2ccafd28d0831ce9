"""Targets of fingertips over time: boxes in space."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Ids, steps_in
from cadenza.agents.planner.plan.presses import RISE, Press, Strike
from cadenza.agents.planner.plan.strike_model import strike_model, striking_torque
from cadenza.fingers import SIDES
from cadenza.scene.scene import Scene

# Where fingertips press and stay, towards the player from the middle of the white keys [m].
_ON_BLACK = 0.0  # on their ridge; on white keys it depends on the finger, clear of black keys
_FROM_FRONT = 0.004  # not nearer to the player's end of white keys
_BEFORE_BLACK, _BESIDE_BLACK = 0.01, 0.0015  # in front of black keys; from them to the finger
_OVER_KEYS = (-0.04, 0.066)  # of idle fingers

_TOLERANCE = np.array([0.003, 0.001])  # [m] along the key, across it
_DEEP = 0.0015  # [m] below the stop of the key
_HOVER, _HOVER_ROOM = 0.006, 0.006  # [m] above a key that is about to be pressed
_APPROACH_HOVER = 0.01  # [m] above it before that
_LIFTED = 0.008  # [m] above a released key, and above all keys for an idle finger
_APPROACH = 0.2  # [s] before a press in which its finger gets over the key
_READY = 0.05  # [s] of these in which it is just above the key
_FORCE_MARGIN = 1.6  # of the force that just holds a key down: a margin for what is not modelled
# Factor of that force while a white key goes down, to overcome its inertia. Fingertips would slip
# off black keys.
_STRIKE = 1.5
_STRIKING = 0.05  # [s] for which that factor applies
# Before a timed strike.
_MAX_DEPTH_BEFORE = 0.75  # share of the depth at which the key sounds
_MAX_DEPTH_LET_GO = 0.4  # the same if the key was just released, and has to come up in time
_MAX_HEIGHT_BEFORE = 0.012  # [m]
_READY_ROOM, _READY_SIGMA = 0.0005, 0.0015  # [m]

# The weight of a box: the distance from it [m] that counts as one standard deviation.
_X_ON_BLACK = 0.5  # factor along black keys: a fingertip is caught in front of them
# Small along the key, too: friction delays a fingertip that has to slide, and with it the hand.
_AT_KEY = np.array([0.003, 0.0015, 0.001])
_ABOVE_KEY = np.array([0.006, 0.0015, 0.003])
_IDLE = np.array([0.005, 1.0, 0.006])
_IN_JUMP = np.array([16.0, 16.0, 1.0])  # factors in a jump, where only the height matters
_BEFORE_LANDING_ON_BLACK = np.array([2.0, 2.0, 1.0])  # factors just before the landing


class Targets(NamedTuple):
    """Boxes for F fingertips in S states, (S, F, 3) each, and the forces that they press with."""

    low: Array
    high: Array
    sigma: Array  # distances from the box that count as one standard deviation [m]
    wall: Array  # (S, F) the minimum x of a tip on a white key, where black keys begin [m]
    force: Array  # (S, F) the forces of fingertips, downwards [N]

    def part(self, first: int, last: int) -> Targets:
        """The states from `first` up to, not including, `last`, as views."""
        return Targets._make(rows[first:last] for rows in self)


def by_hand(rows: Array, hands: int) -> Array:
    """Reshape rows (N, H X, ...), in which values of a hand are adjacent, to (N, H, X, ...)."""
    return rows.reshape(len(rows), hands, -1, *rows.shape[2:])


def pressing_forces(heights: Array, force: Array) -> Array:
    """(S, H, A) the forces along the servos' coordinates that press keys, by virtual work.

    `heights` (S, H, F, A) is the Jacobian of the heights of a hand's fingertips, and `force`
    (S, H, F) are their forces, downwards [N].
    """
    return -np.einsum("shfa,shf->sha", heights, force)


def targets_of(scene: Scene, presses: Sequence[Press], num_states: int, dt: float) -> Targets:
    """Targets of the fingertips of a scene's hands for `presses`, in states `dt` [s] apart.

    Idle fingers stay above all keys.
    """
    return _TargetWriter(scene, num_states, dt).write(presses)


class _TargetWriter:
    """Writes presses into targets that begin with all fingers idle."""

    def __init__(self, scene: Scene, num_states: int, dt: float) -> None:
        self._model = strike_model(scene, dt)
        self._dt, self._keyboard, geometry = dt, scene.keyboard, _finger_geometry(scene)
        self._radius, self._on_white, self._walls, self._above_all = geometry
        shape = (num_states, len(self._radius), 3)
        low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
        low[:, :, 0], high[:, :, 0] = _OVER_KEYS
        low[:, :, 2] = self._above_all
        sigma = np.broadcast_to(_IDLE, shape).copy()
        self._targets = Targets(low, high, sigma, np.full(shape[:2], -np.inf), np.zeros(shape[:2]))

    def write(self, presses: Sequence[Press]) -> Targets:
        """The targets with all presses in them."""
        if presses:
            arrays = _PressArrays.of(presses, len(self._targets.low))
            tops = self._at(arrays, np.zeros(len(presses)))
            self._hold(arrays)
            self._release(arrays, tops)
            self._approach(arrays, tops)
            self._strike(arrays, tops)
        return self._targets

    def _approach(self, presses: _PressArrays, tops: Array) -> None:
        """Put fingers over the `tops` (P, 3) of keys, ever closer, and low when ready."""
        approach, ready = steps_in(_APPROACH, self._dt), steps_in(_READY, self._dt)
        risen = presses.before + steps_in(RISE, self._dt)
        which, states = self._spread(np.maximum(presses.first - approach, risen), presses.first)
        ahead, height = presses.first[which] - states, tops[which, 2]
        is_ready = ahead <= ready
        low = height + np.where(is_ready, _HOVER, _APPROACH_HOVER)
        high = np.where(is_ready, height + _HOVER + _HOVER_ROOM, np.inf)
        from_above = presses.from_above[which] & ~is_ready
        above_all = self._above_all[presses.finger[which]]
        low = np.where(from_above, np.maximum(low, above_all), low)
        sigma = _ABOVE_KEY * np.maximum(ahead / ready, 1.0)[:, None]
        sigma[:, 2] = np.where(is_ready, _ABOVE_KEY[2], _IDLE[2])
        jumps = presses.jumps_to[which]
        lands = is_ready & self._keyboard.is_black[presses.key[which]]
        sigma[jumps & lands] *= _BEFORE_LANDING_ON_BLACK
        sigma[jumps & ~lands] *= _IN_JUMP
        self._box(presses, which, states, tops, (low, high), sigma)

    def _hold(self, presses: _PressArrays) -> None:
        """Put fingers just below the stops of their keys, with the force that holds keys down."""
        keyboard, key = self._keyboard, presses.key
        at = self._at(presses, keyboard.travel[key])
        which, states = self._spread(presses.first, presses.last)
        depth = at[which, 2] - _DEEP
        self._box(presses, which, states, at, (depth, depth), np.tile(_AT_KEY, (len(which), 1)))
        lever = at[:, 0] - keyboard.centre[key, 0] + keyboard.half_size[key, 0]
        force = (_FORCE_MARGIN * keyboard.holding_torque[key] / lever)[which]
        struck = states < presses.first[which] + steps_in(_STRIKING, self._dt)
        force[struck & ~keyboard.is_black[key[which]]] *= _STRIKE
        self._targets.force[states, presses.finger[which]] = force

    def _strike(self, presses: _PressArrays, tops: Array) -> None:
        """Set height before, depth after and force of timed strikes, by the strike model."""
        inside = (presses.first > 0) & (presses.first < len(self._targets.low))
        struck = np.flatnonzero(inside & np.isfinite(presses.time))
        if not len(struck):
            return
        keyboard, key, first = self._keyboard, presses.key[struck], presses.first[struck]
        finger, speed, top = presses.finger[struck], presses.speed[struck], tops[struck]
        lever = top[:, 0] - keyboard.centre[key, 0] + keyboard.half_size[key, 0]
        sounds_at = np.tan(keyboard.sounds_from[key]) * lever
        before, after = self._model.heights(presses.time[struck], speed * lever, sounds_at)
        targets = self._targets
        just_released = presses.before[struck] >= first - 1
        share = np.where(just_released, _MAX_DEPTH_LET_GO, _MAX_DEPTH_BEFORE)
        before = np.clip(before, -share * sounds_at, _MAX_HEIGHT_BEFORE)
        # A finger that has just released another key is not there yet.
        free = (~just_released | presses.again[struck]) & ~presses.jumps_to[struck]
        ready = first[free] - 1, finger[free]
        height = top[free, 2] + before[free]
        targets.low[*ready, 2], targets.high[*ready, 2] = height - _READY_ROOM, height + _READY_ROOM
        targets.sigma[*ready, 2] = _READY_SIGMA
        stop_depth = np.tan(keyboard.travel[key]) * lever
        depth = top[:, 2] + np.minimum(after, -stop_depth)
        targets.low[first, finger, 2] = targets.high[first, finger, 2] = depth
        targets.force[first, finger] = striking_torque(keyboard, key, speed) / lever

    def _release(self, presses: _PressArrays, tops: Array) -> None:
        """Lift fingers straight up, so that they do not drag along the key; in a jump just up."""
        risen = presses.last + steps_in(RISE, self._dt)
        which, states = self._spread(presses.last, np.minimum(risen, presses.until))
        sigma = np.tile(_ABOVE_KEY, (len(which), 1))
        sigma[presses.jumps_off[which]] *= _IN_JUMP
        height = tops[which, 2] + _LIFTED, np.full(len(which), np.inf)
        self._box(presses, which, states, tops, height, sigma)

    def _spread(self, first: Ids, last: Ids) -> tuple[Ids, Ids]:
        """Indices (N,) of presses, and (N,) all their states from `first` (P,) to `last` (P,)."""
        counts = np.maximum(np.minimum(last, len(self._targets.low)) - first, 0)
        which = np.repeat(np.arange(len(first)), counts)
        begins = np.cumsum(counts) - counts
        return which, np.arange(len(which)) - (begins - first)[which]

    def _box(
        self,
        presses: _PressArrays,
        which: Ids,
        states: Ids,
        at: Array,
        height: tuple[Array, Array],
        sigma: Array,
    ) -> None:
        """Write boxes (N,) around places `at` (P, 3), between two heights (N,)."""
        targets, places, finger = self._targets, at[which, :2], presses.finger[which]
        low, high = (
            np.column_stack([places + room, z])
            for room, z in zip((-_TOLERANCE, _TOLERANCE), height, strict=True)
        )
        black = self._keyboard.is_black[presses.key[which]]
        sigma[black, 0] *= _X_ON_BLACK
        targets.low[states, finger], targets.high[states, finger] = low, high
        targets.sigma[states, finger] = sigma
        targets.wall[states[~black], finger[~black]] = self._walls[finger[~black]]

    def _at(self, presses: _PressArrays, angle: Array) -> Array:
        """Places (P, 3) of fingertips on keys that are down by `angle` (P,) [rad]."""
        keyboard, key = self._keyboard, presses.key
        centre, half = keyboard.centre[key], keyboard.half_size[key]
        front = keyboard.white.centre_x + keyboard.white.half_size[0]
        on_white = np.minimum(self._on_white, front - _FROM_FRONT)[presses.finger]
        x = np.where(keyboard.is_black[key], _ON_BLACK, on_white)
        fall = np.tan(angle) * (x - centre[:, 0] + half[:, 0])
        height = centre[:, 2] + half[:, 2] - fall + self._radius[presses.finger]
        return np.column_stack([x, centre[:, 1], height])


class _FingerGeometry(NamedTuple):
    """Lengths of F fingers, (F,) each [m]."""

    radius: Array  # the radius of the tip
    # Where the finger presses white keys, from their middle towards the player
    on_white: Array
    walls: Array  # the limit of the room in front of black keys, likewise
    above_all: Array  # the height of the tip above all keys


@lru_cache(maxsize=8)  # for short plans
def _finger_geometry(scene: Scene) -> _FingerGeometry:
    fingers, black = scene.hand.fingers * len(SIDES), scene.keyboard.black
    radius = np.array([finger.tip_radius for finger in fingers])
    # To the micrometre: the sum must not depend on how its parts are written.
    front = black.centre_x + black.half_size[0]
    walls = np.round(front + np.maximum(_BEFORE_BLACK, radius + _BESIDE_BLACK), 6)
    on_white = np.array([finger.on_white for finger in fingers])
    return _FingerGeometry(radius, on_white, walls, black.top + _LIFTED + radius)


_ANY_STRIKE = Strike(np.nan, np.nan)


class _PressArrays(NamedTuple):
    """P presses as arrays (P,)."""

    finger: Ids
    key: Ids
    first: Ids
    last: Ids
    before: Ids  # the end of the finger's previous press
    until: Ids  # the beginning of its next press
    again: NDArray[np.bool_]  # whether the previous press was of the same key
    jumps_off: NDArray[np.bool_]
    jumps_to: NDArray[np.bool_]
    from_above: NDArray[np.bool_]
    time: Array  # the time of the strike within its step [s], NaN if it does not matter
    speed: Array  # the speed of the key then [rad/s]

    @classmethod
    def of(cls, presses: Sequence[Press], num_states: int) -> _PressArrays:
        """The arrays of presses by time, in a plan of `num_states` states."""
        before, until = np.zeros(len(presses), np.intp), np.full(len(presses), num_states)
        again, last_of_finger = np.zeros(len(presses), bool), dict[int, int]()
        for i, press in enumerate(presses):
            if press.finger in last_of_finger:
                j = last_of_finger[press.finger]
                before[i], until[j] = presses[j].last, press.first
                again[i] = presses[j].key == press.key
            last_of_finger[press.finger] = i
        finger, key, first, last = np.array(
            [(press.finger, press.key, press.first, press.last) for press in presses]
        ).T
        jumps = np.array(
            [(press.jumps_off, press.jumps_to, press.from_above) for press in presses]
        ).T
        strikes = np.array([press.strike or _ANY_STRIKE for press in presses]).T
        return cls(finger, key, first, last, before, until, again, *jumps, *strikes)
