"""Motions of one hand around changes of the keys that it holds, stitched together."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cadenza.agents.agent import Array, Progress, silent, steps_in
from cadenza.agents.planner.plan.fingertip_targets import Targets, targets_of
from cadenza.agents.planner.plan.inverse_kinematics import solve_postures
from cadenza.agents.planner.plan.presses import Press
from cadenza.agents.planner.plan.rest_poses import forearm_places, rest_posture
from cadenza.scene.kinematics import Kinematics
from cadenza.scene.scene import Scene
from cadenza.scene.servos import servos_of

Held = tuple[tuple[int, int], ...]  # pairs of finger and key, of each finger that is down

_BEFORE = 0.2  # [s] of a motion before the keys change, in which fingers get over their keys
_AFTER = 0.15  # [s] of it afterwards, in which the other fingers rise
_GAP = 0.3  # [s] from release to strike, at most
_AT_REST = 10.0  # [s] between two postures, so that the speed of the motion costs nothing
_OCTAVE = 12


class KeyChange(NamedTuple):
    """A change of held keys: some are released, and others struck at once or soon after."""

    held_before: Held  # all keys that are held before
    held_through: Held  # the keys of these that are not released
    held_after: Held  # all keys that are held at the end
    gap: int  # the number of states from releasing to striking

    def lowered(self, keys: int) -> KeyChange:
        """This change, `keys` further down the keyboard."""
        before, through, after = (
            tuple((finger, key - keys) for finger, key in held) for held in self[:3]
        )
        return KeyChange(before, through, after, self.gap)


class Motions:
    """Postures of one hand around each change of the keys that it holds.

    A motion is planned on first use, by inverse kinematics of this change alone, from a hand at
    rest. It is the same in every octave except for the place of the forearm, and does not depend on
    other changes.

    Attributes:
        before: the number of states of a motion before the state in which keys are released.
        after: the number of states after the state in which keys are struck.
        longest_gap: the maximum number of states between these two.
    """

    def __init__(self, scene: Scene, dt: float, progress: Progress = silent) -> None:
        """Begin without motions, for a hand alone in a scene and control steps of `dt` [s]."""
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
        self._cache: dict[KeyChange, Array] = {}

    def __len__(self) -> int:
        return len(self._cache)

    def of(self, change: KeyChange) -> Array:
        """Postures (N, A) of a change: row 0 holds the first keys, row `before` releases them."""
        keys = [key for _, key in change.held_before + change.held_after]
        up = self._octaves(keys)
        lowered = change.lowered(up)
        if lowered not in self._cache:
            self._cache[lowered] = self._posture_sequence(lowered)
            self._progress("motions", len(self), len(self))
        key, centre = keys[0], self._keyboard.centre[:, 1]
        motion = self._cache[lowered].copy()
        motion[:, self._slide] += centre[key] - centre[key - up]
        return motion

    def _octaves(self, keys: list[int]) -> int:
        """Keys of the octaves to the middle of the keyboard, where motions are planned."""
        lowest = min(keys)
        room = self._keyboard.num_keys - (max(keys) - lowest)
        first = lowest % _OCTAVE
        return lowest - first - max((room // 2 - first) // _OCTAVE, 0) * _OCTAVE

    def _posture_sequence(self, change: KeyChange) -> Array:
        """Postures (N, A) of a change, by inverse kinematics of its presses."""
        before, through, after, gap = change
        release, strike = self.before, self.before + gap
        end = strike + self.after + 1
        start, goal = self._place(before or after), self._place(after or before)
        jumps = gap > 0 and abs(goal - start) > self._scene.hand.jump_times.within_reach
        presses = []
        for finger, key in before:
            stays = (finger, key) in through
            last = release if not stays else end if (finger, key) in after else strike
            presses.append(Press(self._side, finger, key, 1, last, jumps_off=jumps))
        for finger, key in after:
            if (finger, key) not in through:
                jumps_to = jumps and len(after) == 1
                presses.append(Press(self._side, finger, key, strike, end, jumps_to=jumps_to))
        targets = targets_of(self._scene, presses, end, self._dt)
        guess = np.tile(self._rest, (end, 1))
        guess[:, self._slide] = np.interp(np.arange(end), [0, strike], [start, goal])
        guess[0] = self._holding(before, guess[0])
        return self._postures(targets, guess, self._dt)

    def _holding(self, held: Held, guess: Array) -> Array:
        """Posture (A,) at rest with keys down."""
        presses = [Press(self._side, finger, key, 1, 2) for finger, key in held]
        targets = targets_of(self._scene, presses, 2, self._dt)
        return self._postures(targets, np.stack([guess, guess]), _AT_REST)[1]

    def _postures(self, targets: Targets, guess: Array, dt: float) -> Array:
        """Postures (S, A), `dt` [s] apart, of a hand that was at rest before."""
        return solve_postures(self._kinematics, targets, guess, guess[0], dt)

    def _place(self, held: Held) -> float:
        """Mean position of the forearm at which fingers press their keys in their rest pose [m]."""
        return float(np.mean([self._places[key, finger] for finger, key in held]))


def stitched(presses: Sequence[Press], motions: Motions, start: Array, num_states: int) -> Array:
    """Postures (S, A) of a hand that begins at `start` (A,), with these presses.

    Between two changes, the end of one motion is blended with the beginning of the next.
    """
    postures = np.empty((num_states, len(start)))
    tail, since = start[None], 0
    for release, change in changes_of(presses, num_states, motions.longest_gap):
        motion = motions.of(change)
        states = np.arange(since, release)
        blend_end = max(release - motions.before, min(since + motions.after, release - 1))
        share = np.minimum((states - since) / max(blend_end - since, 1), 1.0)[:, None]
        next_motion = motion[np.maximum(states - release + motions.before, 0)]
        postures[states] = (1 - share) * _at_states(tail, states - since) + share * next_motion
        since = release + change.gap
        postures[release:since] = motion[motions.before :][: change.gap]
        tail = motion[motions.before + change.gap :]
    postures[since:] = _at_states(tail, np.arange(num_states - since))
    return postures


def _at_states(motion: Array, states: NDArray[np.intp]) -> Array:
    """Postures of a motion in `states`; after its end, the last one."""
    return motion[np.minimum(states, len(motion) - 1)]


def changes_of(
    presses: Sequence[Press], num_states: int, longest_gap: int
) -> Iterator[tuple[int, KeyChange]]:
    """Changes of the keys that one hand holds, and the states in which they begin, by time.

    A release and a strike at most `longest_gap` states later are one change.
    """
    queue = list(_chords(presses, num_states))
    before: Held = ()
    while queue:
        release, after_release = queue.pop(0)
        strike, after = release, after_release
        if set(after) < set(before) and queue and queue[0][0] - release <= longest_gap:
            strike, after = queue.pop(0)
        through = tuple(pair for pair in before if pair in after_release)
        yield release, KeyChange(before, through, after, strike - release)
        before = after


def _chords(presses: Sequence[Press], num_states: int) -> Iterator[tuple[int, Held]]:
    """States in which one hand begins to hold other keys, by time, and these keys."""
    strikes, releases = (defaultdict[int, set[tuple[int, int]]](set) for _ in range(2))
    for press in presses:
        if press.first < press.last:
            strikes[press.first].add((press.finger, press.key))
            releases[press.last].add((press.finger, press.key))
    down = set[tuple[int, int]]()
    before: Held = ()
    for state in sorted(strikes.keys() | releases.keys()):
        down = (down - releases[state]) | strikes[state]
        held = tuple(sorted(down))
        if held != before and state < num_states:
            yield state, held
        before = held
