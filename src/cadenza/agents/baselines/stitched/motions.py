"""Motions of one hand from keys that it holds to others, each planned once for all octaves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cadenza.agents.agent import Array, Progress, silent, steps_in
from cadenza.agents.planner.plan.fingertip_targets import Targets, targets_of
from cadenza.agents.planner.plan.inverse_kinematics import solve_postures
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.rest_poses import forearm_places, rest_posture
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of

Held = tuple[tuple[int, int], ...]
"""Pairs of finger and key, of each finger that is down."""

_BEFORE = 0.2  # [s] of a motion before the keys change, in which fingers get over the next ones
_AFTER = 0.15  # [s] after it, in which the others get off theirs
_GAP = 0.3  # [s] from letting go to striking, at most
_AT_REST = 10.0  # [s] between two postures, so that the speed of the motion costs nothing
_OCTAVE = 12


class Change(NamedTuple):
    """A change of held keys: some are released, and others struck at once or soon after."""

    held_before: Held
    """All keys that are held before."""
    kept: Held
    """The keys that were held before and are not released."""
    held_after: Held
    """All keys that are held at the end."""
    gap: int
    """The number of states from releasing to striking."""

    def lowered(self, keys: int) -> Change:
        """This change, moved `keys` down the keyboard."""
        before, kept, after = (
            tuple((finger, key - keys) for finger, key in held) for held in self[:3]
        )
        return Change(before, kept, after, self.gap)


class Motions:
    """Postures of one hand around each change of the keys that it holds.

    A motion is planned when it is first asked for, by inverse kinematics of this change alone: the
    hand is at rest before it. It is the same in every octave but for the place of the forearm, and
    does not depend on what else was asked for.

    Attributes:
        before: the number of states of a motion before the one in which keys have been released.
        after: the number of states after the one in which others have been struck.
        longest_gap: the maximum number of states between both.
    """

    def __init__(self, scene: Scene, dt: float, progress: Progress = silent) -> None:
        """Begins without any motions, for a hand alone in a scene and control steps of `dt` [s].

        It reports the number of "motions" that have been planned.
        """
        self._scene, self._dt, self._keyboard = scene, dt, scene.keyboard
        self._progress = progress
        self._servos = servos_of(scene)
        self._kinematics = Kinematics(scene)
        self._rest = rest_posture(self._servos)
        self._places = forearm_places(self._kinematics)
        (self._side,) = scene.sides
        (self._slide,) = self._servos.along_keyboard
        self.before, self.after = steps_in(_BEFORE, dt), steps_in(_AFTER, dt)
        self.longest_gap = steps_in(_GAP, dt)
        self._known: dict[Change, Array] = {}

    def __len__(self) -> int:
        return len(self._known)

    def of(self, change: Change) -> Array:
        """(N, A) postures of a change: row 0 holds its first keys, which row `before` releases."""
        pressed = [key for _, key in change.held_before + change.held_after]
        up = self._octaves(pressed)
        lowered = change.lowered(up)
        if lowered not in self._known:
            self._known[lowered] = self._planned(lowered)
            self._progress("motions", len(self), len(self))
        key, centre = pressed[0], self._keyboard.centre[:, 1]
        motion = self._known[lowered].copy()
        motion[:, self._slide] += centre[key] - centre[key - up]
        return motion

    def _octaves(self, keys: list[int]) -> int:
        """The distance, in keys, of `keys` above those for which their motion is planned.

        Motions are planned about the middle of the keyboard.
        """
        lowest = min(keys)
        room = self._keyboard.num_keys - (max(keys) - lowest)
        first = lowest % _OCTAVE
        return lowest - first - max((room // 2 - first) // _OCTAVE, 0) * _OCTAVE

    def _planned(self, change: Change) -> Array:
        """(N, A) postures of a change, by inverse kinematics of its presses."""
        before, kept, after, gap = change
        release, strike = self.before, self.before + gap
        end = strike + self.after + 1
        here, there = self._place(before or after), self._place(after or before)
        jumps = gap > 0 and abs(there - here) > self._scene.hand.jump_times.within_reach
        presses = []
        for finger, key in before:
            stays = (finger, key) in kept
            last = release if not stays else end if (finger, key) in after else strike
            presses.append(Press(self._side, finger, key, 1, last, jumps_off=jumps))
        for finger, key in after:
            if (finger, key) not in kept:
                jumps_to = jumps and len(after) == 1
                presses.append(Press(self._side, finger, key, strike, end, jumps_to=jumps_to))
        targets = targets_of(self._scene, presses, end, self._dt)
        guess = np.tile(self._rest, (end, 1))
        guess[:, self._slide] = np.interp(np.arange(end), [0, strike], [here, there])
        guess[0] = self._holding(before, guess[0])
        return self._postures(targets, guess, self._dt)

    def _holding(self, held: Held, guess: Array) -> Array:
        """(A,) posture at rest with keys down."""
        presses = [Press(self._side, finger, key, 1, 2) for finger, key in held]
        targets = targets_of(self._scene, presses, 2, self._dt)
        return self._postures(targets, np.stack([guess, guess]), _AT_REST)[1]

    def _postures(self, targets: Targets, guess: Array, dt: float) -> Array:
        """(S, A) postures, `dt` [s] apart, of a hand that was at rest before."""
        return solve_postures(self._kinematics, targets, guess, guess[0], dt)

    def _place(self, held: Held) -> float:
        """Mean position of the forearm at which fingers press their keys in their rest pose [m]."""
        return float(np.mean([self._places[key, finger] for finger, key in held]))
